"""A commissioning run over OPC UA against the rig: it identifies, or returns to the safe U."""

import asyncio
import json
import time

import numpy as np
import pytest

from support.feeding import PASSWORD, VALVE, Heard, ListeningRig, settings
from valvemap.app.commission import CommissionRun
from valvemap.app.commission_settings import settings_of
from valvemap.config.commission import CommissionConfig
from valvemap.config.connections import SourceConfig
from valvemap.config.models import Config
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.pipeline.commission_state import Reason
from valvemap.storage.commission_files import RunFiles, last_run, new_run
from valvemap.vocabulary.commission import Phase
from valvemap_rig.circuit import Bench, true_flow
from valvemap_rig.excitation import External
from valvemap_rig.scenario import BUILTIN

pytestmark = pytest.mark.waits

SCENARIO = BUILTIN["external"].model_copy(
    update={"excitation": External(sweep_s=3.1, p2_low_bar=30.0, p2_high_bar=190.0)}
)
SLEW, LOW, HIGH = 300.0, 0.0, 80.0
LOADED = {"load_range_bar": (20.0, 190.0), "load_slew_bar_per_s": 600.0, "safe_load_bar": 150.0}


class Stage:
    """A rig that notes what is written, and a run on it."""

    def __init__(self, tmp_path, **commission):
        self.folder, self.commission = tmp_path / "commission", commission
        self.heard = Heard()

    async def __aenter__(self):
        of_rig = settings("opc.tcp://127.0.0.1:0/valvemap/rig/", "urn:valvemap:rig", "valvemap rig")
        self.rig = await ListeningRig.create(of_rig, SCENARIO, on_block=self.heard.samples)
        self.rig.heard = self.heard
        await self.rig.start()
        self.playing = asyncio.create_task(self.rig.run())
        return self

    async def __aexit__(self, *_):
        self.playing.cancel()
        await asyncio.gather(self.playing, return_exceptions=True)
        await self.rig.stop()

    def config(self):
        return Config(
            source=SourceConfig(
                url=self.rig.url, security="None", user="operator", password=PASSWORD
            ),
            valves=(
                ValveConfig(
                    name=VALVE,
                    nodes=NodesConfig.of_rig(
                        VALVE, commanded=True, loaded="safe_load_bar" in self.commission
                    ),
                    commission=CommissionConfig(
                        range_percent=(LOW, HIGH), slew_percent_per_s=SLEW, **self.commission
                    ),
                ),
            ),
        )

    def run(self, recording=None, **more):
        config = self.config()
        files = RunFiles(recording or new_run(self.folder, VALVE, time.time_ns()), VALVE)
        return CommissionRun(config, settings_of(config.valves[0]), files, **more), files


def keeps_limits(heard):
    t, U = np.array(heard.commands).T
    late = 0.05  # s; commands may arrive closer together than they were sent
    return U.min() >= LOW and U.max() <= HIGH and np.all(np.diff(U) <= SLEW * (np.diff(t) + late))


async def test_a_run_identifies_the_valve_and_hands_it_back(tmp_path):
    async with Stage(tmp_path, sweep_s=10.0, most_s=14.0) as stage:
        run, files = stage.run()
        with files:
            state = await run.run()
        assert (state.phase, state.reason) == (Phase.DONE, Reason.TIME_UP)
        assert keeps_limits(stage.heard)
        assert stage.heard.heartbeats[-1][1] == 0
        U, dp = (x.ravel() for x in np.meshgrid(np.linspace(5, 75, 15), np.linspace(20, 150, 8)))
        Q, _ = run._estimator.predict(run.learnt.state, U, dp, np.full(U.shape, 40.0))
        assert np.sqrt(np.mean((Q - true_flow(Bench(), U, dp)) ** 2)) < 1.0
        lines = [json.loads(line) for line in files.audit.read_text().splitlines()]
        assert [lines[0]["event"], lines[-1]["event"]] == ["started", "ended"]
        assert lines[-1]["phase"] == "DONE"


@pytest.mark.alone  # what is learnt in its 14 s depends on the processor time that it is left
async def test_a_driven_load_crosses_the_range_of_pressure_drops(tmp_path):
    async with Stage(tmp_path, sweep_s=10.0, most_s=14.0, **LOADED) as stage:
        run, files = stage.run()
        with files:
            state = await run.run()
        assert (state.phase, state.reason) == (Phase.DONE, Reason.TIME_UP)
        t, load = np.array(stage.heard.loads).T
        assert (load.min(), load.max()) == pytest.approx((20.0, 190.0), abs=8.0)
        assert np.all(np.abs(np.diff(load)) <= 600.0 * (np.diff(t) + 0.05))
        assert load[-1] == 150.0
        assert run.learnt.drops[0] < 25.0
        assert run.learnt.drops[1] > 160.0
        U, dp = (x.ravel() for x in np.meshgrid(np.linspace(5, 75, 15), np.linspace(20, 150, 8)))
        Q, _ = run._estimator.predict(run.learnt.state, U, dp, np.full(U.shape, 40.0))
        error = np.sqrt(np.mean((Q - true_flow(Bench(), U, dp)) ** 2))
        assert error < 1.0  # .5 in simulated time: tests/pipeline/test_commissioned_map.py


@pytest.mark.alone  # half a second, beside tests that take the processor for longer
async def test_an_abort_reaches_the_safe_u_and_a_resumed_run_keeps_what_was_learnt(tmp_path):
    async with Stage(tmp_path, sweep_s=2.0, most_s=3.0) as stage:
        run, files = stage.run()
        with files:
            running = asyncio.create_task(run.run())
            while run.state.elapsed < 1.5:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.01)
            at = time.monotonic()
            run.abort()
            state = await running
        assert (state.phase, state.reason) == (Phase.ABORTED, Reason.OPERATOR)
        safe = next(t for t, U in stage.heard.commands if t > at and U == 0.0)
        assert safe - at < 0.5
        assert keeps_limits(stage.heard)
        before = run.learnt.samples
        assert before > 100
        again, files = stage.run(last_run(stage.folder, VALVE))
        with files:
            state = await again.run()
        assert state.phase is Phase.DONE
        assert again.learnt.samples > before
        assert keeps_limits(stage.heard)


async def test_a_terminal_that_is_gone_ends_the_run(tmp_path):
    age = 0.0
    async with Stage(tmp_path) as stage:
        run, files = stage.run(operator=lambda: (age, age))
        with files:
            running = asyncio.create_task(run.run())
            while run.state.phase is not Phase.SWEEPING:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.01)
            age = 5.0
            state = await asyncio.wait_for(running, 5.0)
        assert (state.phase, state.reason) == (Phase.ABORTED, Reason.OPERATOR_GONE)


async def test_an_armed_feed_forward_is_refused_before_the_first_command(tmp_path):
    async with Stage(tmp_path) as stage:
        run, files = stage.run(armed=True)
        with files:
            state = await asyncio.wait_for(run.run(), 20.0)
        assert (state.phase, state.reason) == (Phase.REFUSED, Reason.FEED_FORWARD)
        assert stage.heard.commands == []
