"""Whole services that are killed, reloaded, started from a history: what their states are worth."""

import asyncio
import tempfile
import time
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import numpy as np

from guarded_opcua import Role, UserStore
from support.plant import lively
from support.stream import NumberedServer, until
from support.whole import Whole

HISTORY = 40_000  # samples that the source remembers, as the rig does: 400 s
STEP_NS = 10_000_000
START_S = 120.0  # longest start, on a busy machine
SHORTEST_S = 0.3  # of a life, its start with it
IN_STARTS = 2.0  # how long the longest is: of what the first took to start
QUIET_S = 2.5  # after which all sent samples have been learnt


@asynccontextmanager
async def plant_of(*valves, before_s=0.0):
    """A source of lively valves, 100 Hz, that has played for a time; and a folder."""
    users, password = UserStore.one_time("operator", Role.OPERATOR)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plant = await NumberedServer.create(
            users=users, remembers=HISTORY, valves=valves, shows=lively
        )
        if n := round(before_s * 1e9 / STEP_NS):
            plant.remember(n, time.time_ns() - n * STEP_NS, STEP_NS)
        async with plant.server:
            playing = asyncio.create_task(plant.play(round(1e9 / STEP_NS)))
            try:
                yield (plant, password), folder, playing
            finally:
                await stopped(playing)


async def stopped(playing):
    playing.cancel()
    with suppress(asyncio.CancelledError):
        await playing


async def ended_well(whole, process, playing):
    """Let the service learn the last that was sent, and end it."""
    await stopped(playing)
    await asyncio.sleep(QUIET_S)
    await asyncio.to_thread(whole.end, process)


async def kills(count, seed, *, warm_start_s=0.0):
    """``valvemap serve`` killed at random times, the last life ended: account, unreadable files.

    Before the first the source has run for half as long again as the service is to learn from.
    """
    rng, unreadable = np.random.default_rng(seed), 0
    async with plant_of("V1", before_s=1.5 * warm_start_s) as (served, folder, playing):
        whole = Whole(folder, served, source=f"warm_start_s = {warm_start_s}")
        began = time.monotonic()
        with whole.life():
            await until(whole.has_kept, START_S)
            longest_s = IN_STARTS * (time.monotonic() - began)
        for _ in range(count - 1):
            with whole.life() as process:
                await asyncio.sleep(float(rng.uniform(SHORTEST_S, longest_s)))
                whole.check(process)
            kept, damaged = whole.kept()
            unreadable += damaged or not kept
        before = whole.said("first results")
        with whole.life() as process:
            await until(lambda: whole.said("first results") > before, START_S)
            await ended_well(whole, process, playing)
        return whole.account(), unreadable + whole.refusals


async def reload(seconds=5.0):
    """One of two valves is reconfigured while the service runs: account of the other."""
    async with plant_of("V1", "V2") as (served, folder, playing):
        whole = Whole(folder, served, ("V1", "V2"))
        with whole.life() as process:
            await until(whole.has_kept, START_S)
            await asyncio.sleep(seconds)
            whole.write({"V2": "[{ kind = 'RLS', lam = 0.99 }]"})
            whole.hang_up(process)
            await until(lambda: whole.said("configuration taken over"), START_S)
            await asyncio.sleep(seconds)
            await ended_well(whole, process, playing)
        return whole.account("V1")


async def warm_start(seconds=20.0):
    """A service that is started when the source holds a history: account."""
    async with plant_of("V1", before_s=1.5 * seconds) as (served, folder, playing):
        whole = Whole(folder, served, source=f"warm_start_s = {seconds}")
        with whole.life() as process:
            await until(whole.has_kept, START_S)
            await ended_well(whole, process, playing)
        return whole.account()
