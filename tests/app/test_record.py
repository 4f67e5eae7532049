"""What a recording holds is what the running service would have learnt from."""

import asyncio

import numpy as np
import pytest
import structlog

from support.plant import as_changes, plant
from support.processes import free_port
from valvemap.app.record import _Recorder, record
from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.errors import SourceError
from valvemap.pipeline.alignment import Alignment


class Writer:
    def __init__(self):
        self.t = []

    def append(self, _valve, samples):
        self.t += samples.t.tolist()


@pytest.fixture
def writer():
    return Writer()


@pytest.fixture
def recorder(writer):
    return _Recorder(load_config(), writer, lambda _count: None)


async def test_what_waits_behind_a_hole_is_written_at_the_end(recorder, writer):
    samples = plant(40)
    changes = as_changes(samples)
    await recorder.take(changes[np.repeat(np.arange(40) != 20, 6)])
    recorder.finish()
    assert writer.t == np.delete(samples.t, 20).tolist()


async def test_the_samples_of_a_valve_that_is_left_out_are_counted(recorder, writer, monkeypatch):
    samples = plant(40)
    changes = as_changes(samples)
    await recorder.take(changes[: 6 * 10])
    with monkeypatch.context() as patch, structlog.testing.capture_logs() as said:
        patch.setattr(Alignment, "take", raising)
        await recorder.take(changes[6 * 10 : 6 * 20])
        await recorder.take(changes[6 * 20 :])
        recorder.finish()
    assert writer.t == samples.t[:10].tolist()
    (end,) = [entry for entry in said if "missing" in entry["event"]]
    assert end["samples"] == {"Valvistor": 30}


def raising(*_args):
    raise RuntimeError("injected")


async def test_a_restarted_source_counts_its_samples_anew(recorder, writer):
    before, after = plant(40), plant(40, first=500)
    await recorder.connected(restarted_at=None)
    await recorder.take(as_changes(before))
    await recorder.connected(restarted_at=1)
    await recorder.take(as_changes(after))
    recorder.finish()
    assert writer.t == [*before.t.tolist(), *after.t.tolist()]


async def test_a_source_that_is_never_reached_leaves_no_recording(tmp_path):
    url = f"opc.tcp://127.0.0.1:{free_port()}"
    source = {"url": url, "security": "None", "startup_timeout_s": 0.1}
    nodes = {signal: f"s={signal}" for signal in ("U", "p1", "p2", "Q")}
    config = Config(source=source, valves=[{"nodes": nodes}])
    with pytest.raises(SourceError):
        await record(config, tmp_path / "plant.csv", asyncio.Event(), 5.0)
    assert list(tmp_path.iterdir()) == []
