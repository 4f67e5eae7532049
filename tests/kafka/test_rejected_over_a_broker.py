"""Over a real Kafka: hostile messages end nothing, and are dead letters with their place."""

import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from support.broker import artifacts, brokers

pytest.importorskip("confluent_kafka")

from confluent_kafka import Producer, TopicPartition

from support import hostile_messages as hostile
from support.fleet import block, feed, group
from support.fleet_trial import BLOCKS, GROUPS, Trial, memories
from support.kafka import everything, until
from support.processes import free_port, running_command, wait_for
from valvemap.cli import run
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.commands import is_reply
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.memory import read_memory, write_memory
from valvemap.kafka.result_blocks import write_results

pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]
SERVER = Path(__file__).parents[1] / "support" / "fleet_server.py"
