"""Whole services under load: a disk that is slow, a thousand valves for long, half a processor."""

import asyncio
import io
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC
from pathlib import Path

import numpy as np
from asyncua import Client, ua

from benchmarks.live_speed import free_url, names_of, rig
from support.processes import wait_for
from support.slow_disk import environment
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.pipeline.kept_states import MEMORY
from valvemap.pipeline.kernels import waiting

START_S = 600.0  # on a busy machine
PATIENCE_S = 60.0  # for an end
PAUSE_S = 0.02  # between two looks
WATCHED = 50  # valves, whose ages are asked for
AGES_EVERY_S = 1.0
SHOWN = "SampleCount", "PredictedFlow"
STALE_S, LOOK_S = 2.0, 0.5  # as configured; how long after that it must have been seen
STOPPED_S = 0.05
COUNTED = [waiting.GAPS, waiting.MISSING, waiting.LOST_BY_TIME]


@dataclass
class Seen:
    """What a client saw: answers and gaps in s, ages in s, how often something old was Good."""

    answers: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    ages: list[float] = field(default_factory=list)
    old_and_good: int = 0
    own_s: float = 0.0  # longest that the client's own loop stood


@dataclass(frozen=True)
class Service:
    """A service that runs in a separate process, and its source."""

    process: subprocess.Popen[bytes]
    url: str
    names: tuple[str, ...]
    state: Path
    log: Path

    def held(self) -> list[float]:
        """Processor times in s for which something held the loop, until now."""
        lines = self.log.read_text(errors="replace").splitlines()
        return [float(line.split()[2]) for line in lines if line.startswith("held for ")]

    def end(self) -> float:
        """Seconds from the signal until it is gone."""
        began = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(PATIENCE_S)
        return time.monotonic() - began

    def resident_mb(self) -> float:
        pages = Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6

    def kept(self) -> dict[str, tuple[int, np.ndarray]]:
        """Time of the newest sample and counters of each valve, as they are on the disk."""
        query = "SELECT valve, state FROM checkpoint WHERE estimator = ? ORDER BY saved"
        with closing(sqlite3.connect(f"file:{self.state}?mode=ro", uri=True)) as file:
            rows = dict(file.execute(query, (MEMORY,)).fetchall())
        records = {valve: np.load(io.BytesIO(state)) for valve, state in rows.items()}
        return {v: (int(one["moment"]), one["counters"][0].copy()) for v, one in records.items()}


@contextmanager
def service_of(valves: int, hz: float, sync_s: float = 0.0, more: str = "") -> Iterator[Service]:
    """A rig and ``serve`` in its default configuration, once it shows results.

    ``more`` are further sections of the configuration.
    """
    with tempfile.TemporaryDirectory() as name:
        folder, source, url = Path(name), free_url("rig"), free_url("service")
        names = names_of(valves)
        file, log = folder / "service.toml", folder / "log"
        file.write_text(
            f'[source]\nurl = "{source}"\nsecurity = "None"\nstartup_timeout_s = 600.0\n'
            f'timeout_s = 60.0\n[server]\nurl = "{url}"\n'
            f'[state]\nfile = "{folder}/state.sqlite"\n{more}'
            + "".join(f'[[valves]]\nname = "{name}"\n' for name in names)
        )
        command = [sys.executable, "-u", "-m", "benchmarks.open_service", str(file)]
        env = environment(folder, sync_s) if sync_s else None
        with rig(valves, hz, source, {}), log.open("wb") as out:
            process = subprocess.Popen(command, stdout=out, stderr=out, env=env)
            try:
                wait_for(log, "first results published", process, START_S)
                try:
                    yield Service(process, url, names, folder / "state.sqlite", log)
                except BaseException:
                    print(log.read_text()[-9000:], file=sys.stderr)
                    raise
            finally:
                if process.poll() is None:
                    process.kill()
                process.wait()


@asynccontextmanager
async def watched(service: Service) -> AsyncIterator[Seen]:
    """A client that monitors one result, and polls the ages of many."""
    seen = Seen()
    async with Client(service.url, timeout=60, watchdog_intervall=60) as client:
        index = await client.get_namespace_index(NAMESPACE)
        chosen = service.names[:: max(1, len(service.names) // WATCHED)]

        async def read(name: str, valves: tuple[str, ...]) -> list[ua.DataValue]:
            ids = [ua.NodeId(f"{valve}.{name}", index) for valve in valves]
            found: list[ua.DataValue] = await client.uaclient.read_attributes(
                ids, ua.AttributeIds.Value
            )
            return found

        await read("RLS.SampleCount", chosen[:1])
        await read("Diagnostics.SampleAge", chosen)  # makes their nodes
        await read("RLS.PredictedFlow", chosen)
        looking = [
            asyncio.create_task(_look(read, chosen[:1], seen)),
            asyncio.create_task(_ask_ages(read, chosen, seen)),
        ]
        try:
            yield seen
        finally:
            for task in looking:
                task.cancel()
            for task in looking:
                with suppress(asyncio.CancelledError):
                    await task


async def _look(read, valve, seen):
    count, since = 0, time.monotonic()
    while True:
        began = time.monotonic()
        (found,) = await read("RLS.SampleCount", valve)
        now = time.monotonic()
        seen.answers.append(now - began)
        if found.Value.Value != count:
            seen.gaps.append(now - since)
            count, since = found.Value.Value, now
        await asyncio.sleep(PAUSE_S)
        seen.own_s = max(seen.own_s, time.monotonic() - now - PAUSE_S)


async def _ask_ages(read, valves, seen):
    while True:
        ages = await read("Diagnostics.SampleAge", valves)
        seen.ages += [v.Value.Value for v in ages if v.Value.Value is not None]
        counts, flows = [await read(f"RLS.{name}", valves) for name in SHOWN]
        for value in (*counts, *flows):
            age = time.time() - value.SourceTimestamp.replace(tzinfo=UTC).timestamp()
            seen.old_and_good += value.StatusCode.is_good() and age > STALE_S + LOOK_S
        await asyncio.sleep(AGES_EVERY_S)


@dataclass(frozen=True)
class SlowDisk:
    """What a client saw of a service whose disk is slow, s; how long its end took."""

    held_s: float  # of processor time, the longest for which something held the loop
    answer_s: float
    gap_s: float
    own_s: float
    end_s: float

    def __str__(self) -> str:
        return (
            f"loop held for {self.held_s:.2f} s of processor time; longest answer "
            f"{self.answer_s:.2f} s, longest without results {self.gap_s:.2f} s (the client's "
            f"own loop stood {self.own_s:.2f} s); SIGTERM {self.end_s:.1f} s"
        )


@dataclass(frozen=True)
class Run:
    """What became of the samples of a long run, of their age, and of the service's memory."""

    learnt: int
    lost: int
    wrong: int  # valves whose counts do not come to the span
    valves: int
    age_p99_s: float
    age_s: float
    old_and_good: int
    memory_mb: float
    slope_mb_h: float

    def __str__(self) -> str:
        return (
            f"{self.lost:,} of {self.learnt + self.lost:,} lost, counted wrongly at {self.wrong} "
            f"of {self.valves:,} valves; age p99 {self.age_p99_s:.2f} s, largest {self.age_s:.2f} "
            f"s; something older than {STALE_S:g} s called Good {self.old_and_good} times; "
            f"memory {self.memory_mb:.0f} MB, {self.slope_mb_h:+.1f} MB/h"
        )


async def slow_disk(valves: int, hz: float, seconds: float, sync_s: float = 2.0) -> SlowDisk:
    """Watch a service whose disk takes this long to sync, and end it."""
    with service_of(valves, hz, sync_s) as service:
        async with watched(service) as seen:
            before = len(service.held())
            await asyncio.sleep(seconds)
            held = service.held()[before:]
        took = await asyncio.to_thread(service.end)
    return SlowDisk(
        held_s=max(held, default=0.0),
        answer_s=max(seen.answers),
        gap_s=max(seen.gaps),
        own_s=seen.own_s,
        end_s=took,
    )


def account(
    before: Mapping[str, tuple[int, np.ndarray]],
    after: Mapping[str, tuple[int, np.ndarray]],
    step_ns: int,
) -> tuple[int, int, int]:
    """Samples learnt, samples counted as lost, and valves whose counts do not come to the span."""
    learnt = lost = wrong = 0
    for valve, (t, counters) in before.items():
        until, later = after[valve]
        grown = later - counters
        own, missed = int(grown[waiting.EMITTED]), int(grown[COUNTED].sum())
        learnt, lost = learnt + own, lost + missed
        wrong += (until - t) != (own + missed) * step_ns
    return learnt, lost, wrong


async def soak(valves: int, hz: float, seconds: float, *, half: bool = False) -> Run:
    """Watch a service that runs for long; with ``half`` it is stopped and continued."""
    with service_of(valves, hz) as service:
        await _until_all_kept(service)
        before, memory = service.kept(), []
        async with watched(service) as seen:
            stopping = asyncio.create_task(_stop_and_continue(service.process)) if half else None
            began = time.monotonic()
            while (passed := time.monotonic() - began) < seconds:
                await asyncio.sleep(1.0)
                if passed > min(600.0, seconds / 6):
                    memory.append((passed, service.resident_mb()))
            if stopping is not None:
                stopping.cancel()
                await asyncio.gather(stopping, return_exceptions=True)
                service.process.send_signal(signal.SIGCONT)
        await asyncio.to_thread(service.end)
        learnt, lost, wrong = account(before, service.kept(), round(1e9 / hz))
    return Run(
        *(learnt, lost, wrong, valves),
        age_p99_s=float(np.percentile(seen.ages, 99)),
        age_s=max(seen.ages),
        old_and_good=seen.old_and_good,
        memory_mb=memory[-1][1],
        slope_mb_h=float(np.polyfit(*np.array(memory).T, 1)[0]) * 3600.0,
    )


async def _until_all_kept(service: Service) -> None:
    """Until a state of each valve that knows a sample is on the disk."""
    async with asyncio.timeout(START_S):
        while sum(t > 0 for t, _ in service.kept().values()) < len(service.names):  # noqa: ASYNC110
            await asyncio.sleep(1.0)


async def _stop_and_continue(process: subprocess.Popen[bytes]) -> None:
    while True:
        process.send_signal(signal.SIGSTOP)
        await asyncio.sleep(STOPPED_S)
        process.send_signal(signal.SIGCONT)
        await asyncio.sleep(STOPPED_S)
