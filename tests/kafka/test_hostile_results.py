"""A results server survives any result or reply, and shows the honest ones."""

import resource
import time

import numpy as np
import pytest

pytest.importorskip("pyarrow")

import structlog
from asyncua import ua

from support import hostile_messages as hostile
from support.fleet import RHYTHM, catalogue, day, feed, group
from support.results import results_settings
from valvemap.errors import CommandRejected
from valvemap.kafka.commands import Command, Reply, is_reply, read_reply, write_message
from valvemap.kafka.decoding import Decoder, Rejected
from valvemap.kafka.group import Group
from valvemap.kafka.reading import Heard
from valvemap.kafka.result_blocks import ResultsBlock, read_results
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.site_results import Show
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.pipeline import operator_ports
from valvemap.pipeline.alarm_results import Remark

NAME = "north.0"
KEY = NAME.encode()
MUTANTS = 400
LIKELY_BAD = 0.5  # of the mutants: the others are honest by chance

# Of flows of 1e308 l/min, which are shown as they are.
pytestmark = pytest.mark.filterwarnings("ignore:(overflow|invalid value|divide by zero)")


@pytest.fixture(scope="module")
def known():
    return catalogue()


@pytest.fixture(scope="module")
def honest(known):
    one = group(known.groups[NAME])
    return feed(one, day(known.groups[NAME]))


class Silent:
    def send(self, command, refused):
        raise AssertionError("no command is expected")

    def tend(self):
        pass


class Shown:
    """A results server that is fed with messages."""

    def __init__(self, known):
        groups = {name: Group(plan, 1, RHYTHM) for name, plan in known.groups.items()}
        self._decoder = Decoder(known)
        self.show = Show(known, "north", FleetConfig(), groups, Silent())
        descriptions = [d for g in groups.values() for d in g.identification.descriptions()]
        self.server = ResultsServer(
            results_settings(none_on_loopback=True), descriptions, self.show.operator
        )
        self.rejected = 0

    async def take(self, message):
        heard = Heard()
        match self._decoder.published(KEY, message):
            case Rejected(reason):
                assert len(reason.splitlines()) == 1
                self.rejected += 1
            case ResultsBlock() as block:
                heard.results.append(block)
            case Reply() as reply:
                heard.replies.append(reply)
        await self.show._take(self.server, heard)

    async def value(self, name):
        node = self.server.server.get_node(ua.NodeId(name, 2))
        return (await node.read_data_value(raise_on_bad_status=False)).Value.Value


def newest(honest):
    return read_results([one for one in honest if not is_reply(one)][-1])


async def test_the_rows_are_rejected_quickly_and_the_honest_results_are_shown(known, honest):
    shown = Shown(known)
    blocks = [one for one in honest if not is_reply(one)]
    bad = list(hostile.results(blocks[0]))
    share = -(-len(bad) // len(blocks))
    async with shown.server:
        for k, message in enumerate(blocks):
            await shown.take(message)
            for name, packed in bad[k * share : (k + 1) * share]:
                before = shown.rejected
                began, kB = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
                await shown.take(packed)
                assert time.process_time() - began < 1.0, name
                assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - kB < 64_000, name
                assert shown.rejected == before + 1, name
    assert shown.rejected == len(bad)
    assert shown.show.failed == 0
    last = newest(honest).results
    for m in range(3):
        (found,) = shown.show.mirror.again([m], 0)
        for name, own in last.estimators.items():
            np.testing.assert_array_equal(found.estimators[name].theta[0], own.theta[m])


async def survive(known, honest, mutants, seed):
    """Mutants between honest messages; return how many were rejected."""
    dice = np.random.default_rng(seed)
    shown = Shown(known)
    asked = [
        *honest,
        write_message(Reply("7", NAME, 1, done=True, values=(1.0, None, 0.0))),
    ]
    assert read_reply(asked[-1]).done
    with structlog.testing.capture_logs() as said:
        async with shown.server:
            for _ in range(mutants):
                message = hostile.mutant(asked[dice.integers(len(asked))], dice)
                began = time.process_time()
                await shown.take(message)
                assert time.process_time() - began < 1.0
            for message in honest:
                await shown.take(message)
    assert [one for one in said if "exc_info" in one] == []
    assert shown.show.failed == 0
    for m in range(3):
        (found,) = shown.show.mirror.again([m], 0)
        for name, own in newest(honest).results.estimators.items():
            np.testing.assert_array_equal(found.estimators[name].theta[0], own.theta[m])
    return shown.rejected


async def test_a_server_survives_mutants_and_shows_the_honest_results_that_follow(known, honest):
    assert await survive(known, honest, MUTANTS, 1) > LIKELY_BAD * MUTANTS


@pytest.mark.soak
@pytest.mark.timeout(3_600)
async def test_a_server_survives_a_hundred_thousand_mutants(known, honest):
    assert await survive(known, honest, 100_000, 2) > LIKELY_BAD * 100_000


async def test_a_reply_with_another_number_of_values_is_refused_in_one_line(known):
    """A worker of another version may answer otherwise."""
    shown = Shown(known)

    class Echo:
        def send(self, command: Command, refused):
            shown.show.operator.take(Reply(command.id, command.group, 1, done=True, values=self.of))

        def tend(self):
            pass

    shown.show.operator._post = echo = Echo()
    for values in ((), (1.0,), (1.0, 2.0, None), (1.0, 2.0, 99.0)):
        echo.of = values
        with pytest.raises(CommandRejected, match="none that this version knows"):
            await shown.show.operator.predict("V0", "RLS", 1.0, 2.0, 3.0)
    echo.of = (1.0, 2.0, 0.0)
    assert (await shown.show.operator.predict("V0", "RLS", 1.0, 2.0, 3.0))[0] == 1.0
    too_long = operator_ports.Command.of(
        "acknowledge", "V0", "Changed", Remark("x" * 5_000, "me", 1)
    )
    with pytest.raises(CommandRejected, match="at most 4096"):
        await shown.show.operator.do(too_long)
