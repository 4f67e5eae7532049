"""Feed-forward in trouble, over OPC UA: the fallback acts within 1 s, range and slew are kept."""

import asyncio
import itertools
import sys
import time
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import pytest_asyncio
from asyncua import ua

from support.feeding import (
    DP,
    FALLBACK_U,
    OWN_U,
    PASSWORD,
    RANGE,
    SLEW,
    VALVE,
    Heard,
    Q,
    feeding_config,
    learnt,
    listening_rig,
    open_settings,
)
from support.processes import READY_S, free_port, service_url
from support.served import patient
from valvemap.app.serve import serve
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import InverseStatus

pytestmark = [pytest.mark.alone, pytest.mark.asyncio(loop_scope="module")]

WITHIN_S = 1.0
DEADLINE_S = 30.0


async def until(condition, *alive, deadline_s=DEADLINE_S):
    """Wait until a condition holds; return what it says."""
    async with asyncio.timeout(deadline_s):
        while not (found := condition()):
            for task in alive:
                if task.done():
                    task.result()
            await asyncio.sleep(0.005)
    return found


class Stage:
    """Rig, service, and an operator at both."""

    def __init__(self, heard, identification, at_rig, at_service):
        self.heard, self.identification = heard, identification
        self.at_rig, self.at_service = at_rig, at_service

    async def status(self):
        node = await self.node("Inverse.FeedForwardStatus")
        return FeedForwardStatus(await node.read_value())

    async def until_status(self, wanted):
        async with asyncio.timeout(DEADLINE_S):
            while await self.status() is not wanted:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.005)

    async def node(self, name):
        index = await self.at_service.get_namespace_index("urn:valvemap:service")
        return self.at_service.get_node(ua.NodeId(f"{VALVE}.{name}", index))

    async def demand(self, flow, drop):
        await (await self.node("Inverse.FlowDemand")).write_value(flow)
        await (await self.node("Inverse.PressureDrop")).write_value(drop)

    async def call(self, name):
        inverse = await self.node("Inverse")
        await inverse.call_method(f"{inverse.nodeid.NamespaceIndex}:{name}")

    async def of_rig(self, owner, method, *arguments):
        index = await self.at_rig.get_namespace_index("urn:valvemap:rig")
        node = self.at_rig.get_node(ua.NodeId(owner, index))
        await node.call_method(ua.NodeId(method, index), *arguments)

    async def at_the_answer(self):
        """Wait until the valve is where the answer leads it; return the answer."""
        await self.demand(Q, DP)
        await self.until_status(FeedForwardStatus.WRITING)

        def wanted():
            return self.identification.answers.required(0)[0].U

        await until(lambda: abs(self.heard.U[-1][1] - wanted()) < 1.0)
        assert OWN_U + 10.0 < wanted() < RANGE[1]
        return wanted()

    async def ramps_down(self, since, wanted):
        """Wait until commands go towards the fallback; return after how long they began to."""

        def falling():
            return [t for t, U in self.heard.commands if t > since and wanted - 2.0 > U]

        began = (await until(falling))[0] - since
        await until(lambda: self.heard.commands[-1][1] == FALLBACK_U)
        return began

    async def is_the_rigs_own(self, since):
        """Wait until the valve is back at the rig's own command; return after how long."""
        found = await until(lambda: [t for t, U in self.heard.U if t > since and U == OWN_U])
        return found[0] - since

    def kept_range_and_slew(self):
        commands = self.heard.commands
        assert all(RANGE[0] <= U <= RANGE[1] for _, U in commands)
        for (t, U), (t_next, U_next) in itertools.pairwise(commands):
            was_the_rigs = any(t < at < t_next and own == OWN_U for at, own in self.heard.U)
            if not was_the_rigs:  # where the valve has been the rig's own, it begins anew
                assert abs(U_next - U) <= SLEW * (t_next - t) + 1e-6
        return len(commands) > 3


@asynccontextmanager
async def operating(url):
    client = patient(url)
    client.set_user("operator")
    client.set_password(PASSWORD)
    async with client:
        yield client


@asynccontextmanager
async def playing(heard):
    async with await listening_rig(heard) as rig:
        task = asyncio.create_task(rig.run())
        try:
            yield rig
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


@asynccontextmanager
async def serving(config, identification):
    stop = asyncio.Event()
    task = asyncio.ensure_future(serve(config, stop, open_settings(config), identification))
    try:
        yield task
    finally:
        stop.set()
        await task


@asynccontextmanager
async def staged(folder, **feed_forward):
    heard = Heard()
    async with playing(heard) as rig:
        url = service_url(free_port())
        config = feeding_config(rig.url, url, folder / "state.sqlite", **feed_forward)
        identification = await asyncio.to_thread(learnt, config)
        async with serving(config, identification) as task:
            await until(lambda: identification.results.counters(0)["aligned"] > 10, task)
            async with operating(rig.url) as at_rig, operating(url) as at_service:
                yield Stage(heard, identification, at_rig, at_service)


async def test_a_killed_service_leaves_the_valve_to_the_rig_and_a_new_one_is_disarmed(tmp_path):
    heard = Heard()
    async with playing(heard) as rig:
        url = service_url(free_port())
        state = tmp_path / "state.sqlite"
        command = (sys.executable, "-m", "support.feeding", rig.url, url, str(state))
        tests = Path(__file__).parents[1]
        process = await asyncio.create_subprocess_exec(*command, cwd=tests)
        try:
            await until(lambda: heard.U and heard.U[-1][1] > OWN_U + 10.0, deadline_s=READY_S)
            process.kill()
            since = time.monotonic()
        finally:
            if process.returncode is None:
                process.kill()
            await process.wait()
        stage = Stage(heard, None, None, None)
        assert await stage.is_the_rigs_own(since) < WITHIN_S
        stage.kept_range_and_slew()
        written = len(heard.commands)
        config = feeding_config(rig.url, url, state)
        identification = await asyncio.to_thread(learnt, config)
        async with serving(config, identification) as task:
            await until(lambda: identification.results.counters(0)["aligned"] > 10, task)
            assert not identification.armed.is_armed(0)
        assert len(heard.commands) == written


@pytest.mark.parametrize("fallback", ["hold", "hand_back"])
async def test_the_other_fallbacks_hold_and_hand_back(tmp_path, fallback):
    async with staged(tmp_path, fallback=fallback) as stage:
        await stage.call("Arm")
        wanted = await stage.at_the_answer()
        since = time.monotonic()
        await stage.of_rig(VALVE, f"{VALVE}.InjectFault", "drop_out.p1", 1.0, 60.0)
        if fallback == "hand_back":
            await stage.until_status(FeedForwardStatus.STALE)
            assert await stage.is_the_rigs_own(since) < WITHIN_S
        else:
            await stage.demand(Q - 20.0, DP)
            await stage.until_status(FeedForwardStatus.STALE)
            beats = len(stage.heard.heartbeats)
            written = len(stage.heard.commands)
            await until(lambda: len(stage.heard.heartbeats) >= beats + 10)
            assert len(stage.heard.commands) == written
            assert stage.heard.U[-1][1] == stage.heard.commands[-1][1] <= wanted + 0.5
        stage.kept_range_and_slew()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def armed(tmp_path_factory):
    async with staged(tmp_path_factory.mktemp("ramp"), fallback="ramp") as stage:
        await stage.demand(Q, DP)
        assert await stage.status() is FeedForwardStatus.DISARMED
        await stage.call("Arm")
        yield stage
        assert stage.kept_range_and_slew()


@pytest_asyncio.fixture(loop_scope="module")
async def stage(armed):
    armed.heard.refuses = False
    await armed.at_the_answer()
    return armed


async def test_the_valve_is_led_from_where_it_is_and_the_heart_beats(stage):
    (_, first), *_ = stage.heard.commands
    assert first == pytest.approx(OWN_U, abs=2.0)
    beats = len(stage.heard.heartbeats)
    since = time.monotonic()
    await until(lambda: len(stage.heard.heartbeats) >= beats + 10)
    assert time.monotonic() - since < 10 / 5.0
    counts = [count for _, count in stage.heard.heartbeats]
    assert counts == list(range(1, len(counts) + 1))


async def test_stale_data_lead_to_the_fallback(stage):
    wanted = await stage.at_the_answer()
    since = time.monotonic()
    await stage.of_rig("TestRig", "Rig.StopScenario")
    assert await stage.ramps_down(since, wanted) < WITHIN_S
    await stage.until_status(FeedForwardStatus.STALE)
    await stage.of_rig("TestRig", "Rig.StartScenario", "external")
    await stage.at_the_answer()


async def test_bad_quality_leads_to_the_fallback(stage):
    wanted = await stage.at_the_answer()
    since = time.monotonic()
    await stage.of_rig(VALVE, f"{VALVE}.InjectFault", "bad_quality.Q", 1.0, 3.0)
    assert await stage.ramps_down(since, wanted) < WITHIN_S
    await stage.until_status(FeedForwardStatus.BAD_SAMPLE)
    await stage.at_the_answer()


async def test_an_extrapolated_answer_leads_to_the_fallback(stage, monkeypatch):
    wanted = await stage.at_the_answer()
    answer = stage.identification.answers.required

    def extrapolated(valve):
        required, status = answer(valve)
        return required._replace(status=InverseStatus.EXTRAPOLATING), status

    since = time.monotonic()
    monkeypatch.setattr(stage.identification.answers, "required", extrapolated)
    assert await stage.ramps_down(since, wanted) < WITHIN_S
    await stage.until_status(FeedForwardStatus.EXTRAPOLATED)
    monkeypatch.undo()
    await stage.at_the_answer()


async def test_a_demand_above_reach_leads_to_the_fallback(stage):
    wanted = await stage.at_the_answer()
    since = time.monotonic()
    await stage.demand(190.0, 30.0)
    assert await stage.ramps_down(since, wanted) < WITHIN_S
    await stage.until_status(FeedForwardStatus.ABOVE_REACH)


async def test_a_refused_write_is_repeated_then_the_rig_has_its_valve_back(stage):
    await stage.at_the_answer()
    heard = stage.heard
    heard.refuses = True
    await stage.demand(Q - 20.0, DP)
    (since, _), *_ = await until(lambda: heard.refused)
    assert await stage.is_the_rigs_own(since) < WITHIN_S
    again = [t for t, _ in heard.refused]
    assert len(again) >= 2
    await stage.until_status(FeedForwardStatus.REFUSED)
    heard.refuses = False
    await stage.at_the_answer()


async def test_disarming_gives_the_valve_back_to_the_rig(stage):
    since = time.monotonic()
    await stage.call("Disarm")
    assert await stage.is_the_rigs_own(since) < WITHIN_S
    assert not await (await stage.node("Inverse.Armed")).read_value()
    await stage.call("Arm")
    await stage.at_the_answer()
