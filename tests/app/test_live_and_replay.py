"""What goes over OPC UA and what is read from a file must teach the same, to the last bit."""

import asyncio

import numpy as np
import pytest

from support.processes import rig_url
from valvemap.app.build import build_identification
from valvemap.app.replay import replay
from valvemap.app.serve import serve
from valvemap.config.estimators import RlsConfig
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.storage.recording_writer import RecordingWriter
from valvemap.storage.recordings import read_recording

SAMPLES = 1_500


@pytest.fixture
def with_plain_least_squares(config):
    (valve,) = config.valves
    plain = RlsConfig(name="LSM", forgetting="exponential", lam=1.0)
    valve = valve.model_copy(update={"estimators": (*valve.estimators, plain)})
    return config.model_copy(update={"valves": (valve,)})


async def live(config, open_server, file):
    """Run the service until it has SAMPLES samples, all of them recorded."""
    identification = build_identification(config)
    stop = asyncio.Event()
    count = 0
    with RecordingWriter(file) as writer:

        def record(valve, samples):
            nonlocal count
            writer.append(valve, samples)
            count += len(samples)
            if count >= SAMPLES:
                stop.set()

        async with asyncio.timeout(120):
            await serve(config, stop, open_server, identification, record)
    return identification


async def test_live_and_replay_agree_to_the_bit_and_with_batch_least_squares(
    with_plain_least_squares, open_server, start_rig, quick_scenario, tmp_path
):
    config = with_plain_least_squares
    by_service, by_rig = tmp_path / "service.csv", tmp_path / "rig.csv"
    port = int(config.source.url.split(":")[2].split("/")[0])
    assert config.source.url == rig_url(port)
    with start_rig(port, "--scenario", quick_scenario, "--record", str(by_rig)):
        identification = await live(config, open_server, by_service)
    assert identification.results.counters(0)["gaps"] == 0
    assert identification.results.counters(0)["missing"] == 0

    sent = np.concatenate([columns(s) for _, s in read_recording(by_rig)])
    came = np.concatenate([columns(s) for _, s in read_recording(by_service)])
    start = np.flatnonzero(sent[:, 0] == came[0, 0])[0]
    np.testing.assert_array_equal(came, sent[start : start + len(came)])

    report = replay([by_service], config)["Valvistor"]
    for name, lane in identification.valves.state(0).lanes.items():
        theta, std = lane.estimator.parameters(lane.state)
        assert list(report[name].parameters.values()) == theta.tolist(), name
        np.testing.assert_array_equal(list(report[name].std.values()), std)

    _, U, p1, p2, Q, T = came.view(np.float64).T
    theta = batch_least_squares(FiveTerms().regressors(U, p1 - p2, T), Q)
    plain = np.array(list(report["LSM"].parameters.values()))
    np.testing.assert_allclose(plain, theta, rtol=1e-9)


def columns(samples):
    """Samples as rows of bits."""
    floats = [samples.U, samples.p1, samples.p2, samples.Q, samples.T]
    return np.stack([samples.t, *(x.view(np.int64) for x in floats)], axis=1)


async def test_a_restart_takes_the_states_up_again(
    config, open_server, start_rig, quick_scenario, tmp_path
):
    port = int(config.source.url.split(":")[2].split("/")[0])
    with start_rig(port, "--scenario", quick_scenario):
        first = await live(config, open_server, tmp_path / "a.csv")
        before = first.results.one(0).estimators["RLS"].sample_count
        second = await live(config, open_server, tmp_path / "b.csv")
    after = second.results.one(0).estimators["RLS"].sample_count
    assert after >= before + SAMPLES
