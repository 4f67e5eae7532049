"""A state file that is removed in use: noticed, alarmed, and written again whole."""

import pytest
import structlog

from support.plant import as_changes, plant
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.storage.checkpoints import CheckpointFile


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state.sqlite"


def remove(path):
    for part in path.parent.glob("state.sqlite*"):
        part.unlink()


async def turn(live, clock):
    clock.advance(10.0)
    await live.tick()
    await live.keeper.settle()


async def test_it_is_alarmed_within_a_save_and_whole_after_the_next(
    path, identification, source, sink, clock
):
    with CheckpointFile(path) as store, structlog.testing.capture_logs() as logs:
        live = LiveService(identification, source, sink, store, clock, LiveSettings())
        await live.start()
        await live.take(as_changes(plant(100)))
        await turn(live, clock)
        remove(path)
        await turn(live, clock)
        clock.advance(0.6)
        await live.tick()
        assert sink.health.checkpoint_failures == 1
        (alarm,) = [a for a in sink.health.alarms if a.name == "Checkpoint"]
        assert alarm.active
        assert "removed or replaced" in alarm.text
        await live.keeper.settle()
        assert [c.estimator for c in store.load() if c.estimator in ("RLS", "RML", "RBF")] == [
            "RBF",
            "RLS",
            "RML",
        ]
        await turn(live, clock)
        clock.advance(0.6)
        await live.tick()
        (alarm,) = [a for a in sink.health.alarms if a.name == "Checkpoint"]
        assert not alarm.active
    assert [log["log_level"] for log in logs if log["event"] == "state file lost"] == ["error"]


async def test_at_the_end_all_is_saved_in_a_new_file(path, identification, source, sink, clock):
    with CheckpointFile(path) as store:
        live = LiveService(identification, source, sink, store, clock, LiveSettings())
        await live.start()
        await live.take(as_changes(plant(100)))
        await live.keep()
        remove(path)
        assert await live.keep()
        kept = identification.states.kept()
    with CheckpointFile(path) as store:
        assert {(c.valve, c.estimator, c.state) for c in kept} == {
            (c.valve, c.estimator, c.state) for c in store.load()
        }
