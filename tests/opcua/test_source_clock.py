"""How far a source's clock is ahead of ours, where it says so late or not at all."""

import pytest

from guarded_opcua import SystemClock
from support.stream import NumberedServer, until
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source import source_clock
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_clock import Reading, SourceClock
from valvemap.opcua_source.source_nodes import ValveNodes

NODES = ValveNodes("V1", *(f"nsu=urn:plant;s=V1.{name}" for name in ("U", "p1", "p2", "Q")))


class LateClock(SystemClock):
    late_s = 0.0

    def now(self):
        return super().now() - round(self.late_s * 1e9)


@pytest.mark.waits
async def test_a_source_that_was_busy_when_we_connected_is_asked_again(monkeypatch):
    monkeypatch.setattr(source_clock, "READ_EVERY_S", 0.05)
    clock = LateClock()
    clock.late_s = 4.0
    plant = await NumberedServer.create(clock=clock)
    async with plant.server:
        source = OpcUaSource(SourceSettings(plant.server.url), (NODES,))
        await source.connect()
        assert -6.0 < source.clock_offset_s <= -4.0
        clock.late_s = 0.0
        await until(lambda: source.clock_offset_s == 0.0)
        await source.close()


def test_what_a_busy_source_says_later_is_not_believed_for_a_minute():
    clock = SourceClock(SystemClock())
    clock.note(Reading(0.0, 0.01))
    for _ in range(5):
        clock.note(Reading(-4.0, 0.01))
    assert clock.ahead_s == 0.0
    clock.note(Reading(-4.0, 0.01))
    assert clock.ahead_s == -4.0


@pytest.mark.parametrize(("ahead_s", "counts"), [(0.1, 0.0), (-1.0, 0.0), (-1.5, -1.5), (3.0, 3.0)])
def test_clocks_that_may_be_the_same_are(ahead_s, counts):
    clock = SourceClock(SystemClock())
    clock.note(Reading(ahead_s, 0.02))
    assert clock.ahead_s == counts
