"""A rig that remembers what was written to it, and a service that feeds it forward."""

import asyncio
import sys
import time
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from pydantic import SecretStr

from guarded_opcua import CommandRejected, Role, ServerSettings, UserStore
from support.users import CHEAP
from valvemap.app.build import build_identification
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI
from valvemap.app.serve import serve
from valvemap.cli.feedforward import commission
from valvemap.config.connections import ServerConfig, SourceConfig
from valvemap.config.estimators import AutoConfig
from valvemap.config.feed_forward import FeedForwardConfig
from valvemap.config.models import Config
from valvemap.config.stores import StateConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.pipeline.operator_ports import Command
from valvemap_rig.excitation import External
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.server import RigServer

PASSWORD = "correct horse"
VALVE = "Valvistor"
OWN_U, FALLBACK_U = 20.0, 10.0
RANGE, SLEW = (5.0, 80.0), 100.0
Q, DP = 110.0, 100.0
SCENARIO = BUILTIN["external"].model_copy(
    update={"excitation": External(U_start_percent=OWN_U, p2_low_bar=100.0, p2_high_bar=100.0)}
)


@dataclass
class Heard:
    """What came in at the rig, and how the valve stood, all with the time (monotonic, s)."""

    commands: list = field(default_factory=list)
    loads: list = field(default_factory=list)
    heartbeats: list = field(default_factory=list)
    refused: list = field(default_factory=list)
    U: list = field(default_factory=list)
    refuses: bool = False

    def samples(self, block):
        self.U.append((time.monotonic(), float(block.valves[VALVE].U_true[-1])))


class ListeningRig(RigServer):
    """A rig that notes what is written, and refuses commands on demand."""

    heard: Heard

    def command_U(self, valve, U):
        if self.heard.refuses:
            self.heard.refused.append((time.monotonic(), U))
            raise CommandRejected("the rig is in manual mode")
        self.heard.commands.append((time.monotonic(), U))
        super().command_U(valve, U)

    def command_load(self, valve, load):
        self.heard.loads.append((time.monotonic(), load))
        super().command_load(valve, load)

    def heartbeat(self, valve, count):
        self.heard.heartbeats.append((time.monotonic(), count))
        super().heartbeat(valve, count)


def settings(url, uri, name):
    """A server without security for the operator."""
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, PASSWORD)
    return ServerSettings(
        url=url,
        application_uri=uri,
        application_name=name,
        namespace_uri=uri,
        users=users,
        none_on_loopback=True,
    )


async def listening_rig(heard):
    of_rig = settings("opc.tcp://127.0.0.1:0/valvemap/rig/", "urn:valvemap:rig", "valvemap rig")
    rig = await ListeningRig.create(of_rig, SCENARIO, on_block=heard.samples)
    rig.heard = heard
    return rig


def feeding_config(rig_url, service_url, state, **feed_forward):
    """A service that may write to the rig's valve."""
    return Config(
        source=SourceConfig(
            url=rig_url,
            security="None",
            user="operator",
            password=SecretStr(PASSWORD),
            startup_timeout_s=60.0,
        ),
        server=ServerConfig(url=service_url),
        state=StateConfig(file=state),
        valves=(
            ValveConfig(
                name=VALVE,
                nodes=NodesConfig.of_rig(VALVE, commanded=True),
                feed_forward=FeedForwardConfig(
                    range_percent=RANGE,
                    slew_percent_per_s=SLEW,
                    fallback_percent=FALLBACK_U,
                    max_age_s=0.4,
                    **feed_forward,
                ),
                estimators=(AutoConfig(),),
            ),
        ),
    )


def learnt(config):
    """An identification that knows the valve."""
    identification = build_identification(config)
    _, refused = identification.restore(_kept())
    assert not refused
    return identification


@cache
def _kept():
    """What is learnt at commissioning."""
    identification = build_identification(feeding_config("opc.tcp://rig:1", "opc.tcp://us:1", "-"))
    commission(identification, SCENARIO)
    return identification.states.checkpoints()


def open_settings(config):
    return settings(config.server.url, APPLICATION_URI, APPLICATION_NAME)


async def _feed_for_ever(rig_url, service_url, state):
    config = feeding_config(rig_url, service_url, Path(state))
    identification = learnt(config)
    identification.do(Command.of("demand", VALVE, Q, DP))
    identification.do(Command.of("arm", VALVE))
    await serve(config, asyncio.Event(), open_settings(config), identification)


if __name__ == "__main__":
    asyncio.run(_feed_for_ever(*sys.argv[1:]))
