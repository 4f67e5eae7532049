"""The first day from the historian: what a source remembers, as if it had been recorded."""

import asyncio
import time
from contextlib import asynccontextmanager

import numpy as np
import pytest
from pydantic import SecretStr

from guarded_opcua import Role, UserStore
from support.stream import NODES, NumberedServer, until, watching
from support.users import CHEAP
from valvemap.app.record import record, record_history
from valvemap.app.replay import replay
from valvemap.app.replay_report import as_json
from valvemap.config.connections import SourceConfig
from valvemap.config.estimators import RlsConfig
from valvemap.config.models import Config
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.errors import SourceRejected
from valvemap.storage.recordings import read_recording

pytestmark = pytest.mark.waits

STEP_NS = 10_000_000
SIGNALS = ("U", "p1", "p2", "Q", "T", "sequence")


@asynccontextmanager
async def plant(remembers):
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    made = await NumberedServer.create(users=users, remembers=remembers)
    async with made.server:
        yield made, password


def config_of(served):
    made, password = served
    source = SourceConfig(
        url=f"opc.tcp://127.0.0.1:{made.port}/plant/",
        security="None",
        user="operator",
        password=SecretStr(password),
        startup_timeout_s=60.0,
    )
    nodes = NodesConfig(**{name: getattr(NODES, name) for name in SIGNALS})
    valve = ValveConfig(name="V1", nodes=nodes, estimators=(RlsConfig(name="RLS"),), insist=True)
    return Config(source=source, valves=(valve,))


def valve_samples(n, seed=1):
    """U, p1, p2, Q and T of a valve."""
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, n), rng.uniform(1, 150, n)
    Q = 0.1 * U * np.sqrt(dp) + rng.normal(0, 0.3, n)
    return np.column_stack([U, np.full(n, 200.0), 200.0 - dp, Q, np.full(n, 40.0)])


async def test_what_a_source_remembers_is_recorded_whole_and_exact(tmp_path):
    n = 3_000
    async with plant(10_000) as served:
        made, _ = served
        t0, signals = time.time_ns() - n * STEP_NS, valve_samples(n)
        made.remember(n + 1, t0, STEP_NS, signals)
        t = (t0 + np.arange(n) * STEP_NS) // 100 * 100
        file = tmp_path / "history.csv"
        count = await record_history(config_of(served), file, int(t[100]), int(t[2_899]))
    assert count == 2_800
    ((valve, samples),) = list(read_recording(file))
    assert valve == "V1"
    np.testing.assert_array_equal(samples.t, t[100:2_900])
    for name, column in zip(("U", "p1", "p2", "Q", "T"), signals[100:2_900].T, strict=True):
        np.testing.assert_array_equal(getattr(samples, name), column)


async def test_a_recording_and_the_history_of_the_same_span_give_the_same_bits(tmp_path):
    live, past = tmp_path / "live.csv", tmp_path / "past.csv"
    async with plant(100_000) as served:
        made, _ = served
        config, stop = config_of(served), asyncio.Event()
        playing = asyncio.create_task(made.play(100))
        recording = asyncio.create_task(record(config, live, stop))
        await until(lambda: made.written > 250 or recording.done(), seconds=90.0)
        stop.set()
        await recording
        playing.cancel()
        ((_, samples),) = list(read_recording(live))
        await record_history(config, past, int(samples.t[0]), int(samples.t[-1]))
    assert past.read_bytes() == live.read_bytes()
    assert as_json(replay([past], config)) == as_json(replay([live], config))


async def test_a_source_without_history_says_what_helps(tmp_path):
    async with plant(0) as served:
        served[0].publish(time.time_ns())
        with pytest.raises(SourceRejected, match=r"keeps no history of these .*valvemap record"):
            await record_history(config_of(served), tmp_path / "x.csv", 0, time.time_ns())


async def test_a_first_start_begins_with_what_the_source_remembers():
    n, back_s = 2_000, 15.0
    async with plant(10_000) as served:
        made, _ = served
        began = time.time_ns()
        made.remember(n, began - n * STEP_NS, STEP_NS)
        async with watching(served, named=True, warm_start_s=back_s) as (_, _, collector):
            waited = (time.time_ns() - began) // STEP_NS
            await until(lambda: len(collector.numbers) > 1_600)
    numbers = collector.numbers
    first = n - round(1e9 * back_s / STEP_NS)
    assert first <= numbers[0] <= first + waited + 1
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
