"""Commissioning over OPC UA: started, watched and aborted at the running service."""

import asyncio
import time
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest
from asyncua import ua

from support.feeding import PASSWORD, VALVE, Heard, ListeningRig, settings
from support.processes import free_port
from support.served import Seen, serving
from valvemap.app.serve import serve
from valvemap.config.commission import CommissionConfig
from valvemap.config.connections import ServerConfig, SourceConfig
from valvemap.config.models import Config
from valvemap.config.stores import StateConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.vocabulary.commission import Phase
from valvemap_rig.excitation import External
from valvemap_rig.scenario import BUILTIN

pytestmark = pytest.mark.waits

SCENARIO = BUILTIN["external"].model_copy(
    update={"excitation": External(sweep_s=3.1, p2_low_bar=30.0, p2_high_bar=190.0)}
)
OTHER = "Other"
SLEW, LOW, HIGH = 300.0, 0.0, 80.0


@asynccontextmanager
async def staged(tmp_path, *more, **commission):
    """A rig that notes what is written, the service on it, and a client of the service.

    ``more`` are further valves.
    """
    heard = Heard()
    of_rig = settings("opc.tcp://127.0.0.1:0/valvemap/rig/", "urn:valvemap:rig", "valvemap rig")
    rig = await ListeningRig.create(of_rig, SCENARIO, on_block=heard.samples)
    rig.heard = heard
    await rig.start()
    playing = asyncio.create_task(rig.run())
    url = f"opc.tcp://127.0.0.1:{free_port()}/valvemap/service/"
    config = Config(
        source=SourceConfig(url=rig.url, security="None", user="operator", password=PASSWORD),
        server=ServerConfig(url=url),
        state=StateConfig(file=tmp_path / "state.sqlite"),
        valves=(
            ValveConfig(
                name=VALVE,
                nodes=NodesConfig.of_rig(VALVE, commanded=True),
                commission=CommissionConfig(
                    range_percent=(LOW, HIGH),
                    slew_percent_per_s=SLEW,
                    **{"operator_s": 5.0, "operator_late_s": 2.0} | commission,  # a busy machine
                ),
            ),
            *more,
        ),
    )
    of_service = settings(url, "urn:valvemap:service", "valvemap")
    try:
        async with serving(serve, config, of_service, VALVE, "Signals.U") as seen:
            yield seen, heard
    finally:
        playing.cancel()
        await asyncio.gather(playing, return_exceptions=True)
        await rig.stop()


async def call(seen, part, name, *arguments):
    owner = seen.node(part)
    method = ua.NodeId(f"{seen.owner}.{part}.{name}", seen.index)
    return await owner.call_method(method, *arguments)


async def until_taken(seen, name):
    """Call a method until it is taken: a run is over before its last samples are learnt."""
    while True:
        with suppress(ua.UaStatusCodeError):
            return await call(seen, "Commission", name, 0.0)
        await asyncio.sleep(0.1)


@asynccontextmanager
async def present(seen):
    """An operator whose client writes the heartbeat."""

    async def beat():
        for k in range(100_000):
            await seen.node("Commission.Heartbeat").write_value(float(k))
            await asyncio.sleep(0.2)

    beating = asyncio.create_task(beat())
    try:
        yield
    finally:
        beating.cancel()
        with suppress(asyncio.CancelledError):
            await beating


def keeps_limits(heard):
    t, U = np.array(heard.commands).T
    late = 0.05  # s; commands may arrive closer together than they were sent
    return U.min() >= LOW and U.max() <= HIGH and np.all(np.diff(U) <= SLEW * (np.diff(t) + late))


def is_over(state):
    return Phase(state).is_over


async def test_a_run_is_started_watched_and_ends_with_a_map(tmp_path):
    async with staged(tmp_path, sweep_s=6.0, most_s=9.0) as (seen, heard):
        assert await seen.value("Commission.State") == Phase.IDLE
        async with asyncio.timeout(60), present(seen):
            await call(seen, "Commission", "Start", 0.0)
            await seen.until("Commission.State", lambda state: state == Phase.SWEEPING)
            with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
                await call(seen, "Commission", "Start", 0.0)
            with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
                await call(seen, "Inverse", "Arm")
            await seen.until("Commission.MapStd", lambda std: 0.0 < std < 5.0)
            assert 0.0 < await seen.value("Commission.TimeLeft") <= 9.0
            assert "left" in await seen.value("Commission.Progress")
            await seen.until("Commission.State", is_over)
        assert await seen.value("Commission.State") == Phase.DONE
        assert await seen.value("Commission.Reason") == "the time is up"
        assert await seen.value("Commission.TimeLeft") == 0.0
        recording = tmp_path / "commission"
        assert str(recording) in await seen.value("Commission.Recording")
        (audit,) = recording.glob("*.audit.jsonl")
        assert '"user": "operator' in audit.read_text(encoding="utf-8")
        assert keeps_limits(heard)
        assert heard.heartbeats[-1][1] == 0
        await call(seen, "Inverse", "Arm")


@pytest.mark.alone  # a bound on time
async def test_abort_reaches_the_safe_u_within_half_a_second(tmp_path):
    async with staged(tmp_path) as (seen, heard):
        async with asyncio.timeout(60), present(seen):
            await call(seen, "Commission", "Start", 0.0)
            await seen.until("Commission.State", lambda state: state == Phase.SWEEPING)
            await asyncio.sleep(1.0)
            at = time.monotonic()
            await call(seen, "Commission", "Abort")
            await seen.until("Commission.State", is_over)
        assert await seen.value("Commission.Reason") == "the operator aborted"
        assert next(t for t, U in heard.commands if t > at and U == 0.0) - at < 0.6
        assert keeps_limits(heard)


async def test_an_aborted_run_is_resumed_with_what_it_had_learnt(tmp_path):
    async with staged(tmp_path, sweep_s=3.0, most_s=5.0) as (seen, heard):
        with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
            await call(seen, "Commission", "Resume", 0.0)
        async with asyncio.timeout(90), present(seen):
            await call(seen, "Commission", "Start", 0.0)
            await seen.until("Commission.TimeLeft", lambda left: left < 3.5)
            await call(seen, "Commission", "Abort")
            await seen.until("Commission.State", is_over)
            recording = await seen.value("Commission.Recording")
            await until_taken(seen, "Resume")
            await seen.until("Commission.State", lambda state: state == Phase.SWEEPING)
            assert await seen.value("Commission.TimeLeft") < 3.6
            await seen.until("Commission.State", is_over)
        assert await seen.value("Commission.State") == Phase.DONE
        assert await seen.value("Commission.Recording") == recording
        with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
            await call(seen, "Commission", "Resume", 0.0)
        assert keeps_limits(heard)


async def test_a_run_waits_for_disarming_and_ends_without_the_operators_heartbeat(tmp_path):
    other = ValveConfig(name=OTHER, nodes=NodesConfig.of_rig(VALVE))  # no node to write to
    async with staged(tmp_path, other, operator_s=1.0) as (seen, heard):
        async with asyncio.timeout(60):
            not_led = Seen(seen.client, seen.index, OTHER)
            assert await not_led.value("Signals.U") is not None
            with pytest.raises(ua.UaStatusCodeError, match="BadNodeIdUnknown"):
                await call(not_led, "Commission", "Start", 0.0)
            await call(seen, "Inverse", "Arm")
            with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
                await call(seen, "Commission", "Start", 0.0)
            await call(seen, "Inverse", "Disarm")
            await call(seen, "Commission", "Start", 0.0)
            await seen.until("Commission.State", is_over)
        assert "no sign of the operator" in await seen.value("Commission.Reason")
        assert all(U == 0.0 for _, U in heard.commands[-1:])


async def test_the_end_of_the_service_ends_the_run_at_its_safe_u(tmp_path):
    async with staged(tmp_path) as (seen, heard), asyncio.timeout(60), present(seen):
        await call(seen, "Commission", "Start", 0.0)
        await seen.until("Commission.State", lambda state: state == Phase.SWEEPING)
        await asyncio.sleep(1.0)
    assert heard.commands[-1][1] == 0.0
    assert heard.heartbeats[-1][1] == 0
    assert keeps_limits(heard)
