"""The benchmark over OPC UA: its rig publishes another valve's flow, and obeys the run."""

import pytest

from benchmarks import commission_live as live
from benchmarks.commission_plant import VALVES

pytestmark = pytest.mark.waits


async def test_the_rig_has_the_valves_own_course_while_nobody_commands(tmp_path, monkeypatch):
    monkeypatch.setattr(live.Listening, "seconds", 1.5)
    valve = VALVES["U of both signs, play 3 %"]
    samples, ended = await live.received(valve, 1, "machine work", tmp_path, 1.0)
    assert len(samples) > 50
    assert samples.U.min() >= valve.U_range[0]
    assert abs(samples.Q).max() > 1.0
    assert "ABORTED" not in ended


async def test_a_run_drives_u_and_load_of_the_rig(tmp_path, monkeypatch):
    monkeypatch.setattr(live, "TIMES", (3.0, 5.0))
    samples, ended = await live.received(VALVES["ordinary, no play"], 1, "triangles", tmp_path, 1.0)
    assert ended.startswith("DONE the time is up")
    assert samples.U.max() > 95.0
    assert samples.dp.max() - samples.dp.min() > 100.0


async def test_a_rig_that_fails_ends_the_measurement(tmp_path, monkeypatch):
    def fails(*_):
        raise ArithmeticError("of the plant")

    monkeypatch.setattr(live.Plant, "sample", fails)
    with pytest.raises(ArithmeticError, match="of the plant"):
        await live.received(VALVES["ordinary, no play"], 1, "commission", tmp_path, 1.0)
