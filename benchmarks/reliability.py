"""Losses by cuts, kills, disorder, damage and load: ``python -m benchmarks.reliability``.

Writes each row into ``docs/reliability.md``. One valve at 100 Hz from a guarded server in the same
process, through a proxy that cuts and stalls; every sample is numbered, so every loss shows.
``--hour [SECONDS]`` runs 1,000 valves for that time, ``--only half`` with half a processor.
"""

import argparse
import asyncio
import io
import json
import os
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from guarded_opcua import Role, UserStore
from valvemap.errors import StorageError
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage.checkpoints import CheckpointFile

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from benchmarks import reliability_lives, reliability_load
from support import forks
from support.lives import fresh
from support.plant import plant as samples_of
from support.stream import NumberedServer, until, watching
from support.whole import Account

PAGE = Path(__file__).parents[1] / "docs" / "reliability.md"
FAULTS = "| fault | lost | twice | bits different | data again after, s |"
LOADS = "| circumstance | measured |"
Rows = Iterable[tuple[str, str]]
HISTORY = 40_000  # samples that the source remembers: 400 s
ALIGN = Alignment(AlignmentSettings(), (("T",),), (True,))


def disorder(delay_s: float, *, doubled: bool, again_s: float, seed: int) -> str:
    """Samples reordered, doubled, sent again."""
    n, rng = 6_000, np.random.default_rng(seed)
    t = 1_800_000_000_000_000_000 + np.arange(n) * 10_000_000
    values = np.column_stack([*rng.uniform(0, 100, (5, n)), 1_000 + np.arange(n)])
    item = np.tile(np.arange(6, dtype=np.int32), n)
    changes = DataChanges(item, values.ravel(), np.zeros(6 * n, np.uint32), np.repeat(t, 6))
    order = np.argsort(changes.source_time + rng.uniform(0, delay_s, 6 * n) * 1e9, kind="stable")
    if doubled:
        order = np.concatenate([np.tile(part, 2) for part in np.array_split(order, 500)])
    if again_s:
        back = order[-round(600 * again_s) - 1_800 : -1_800]
        order = np.concatenate([order[:-1_800], back, order[-1_800:]])
    mixed = DataChanges(*(column[order] for column in vars(changes).values()))
    (_, ours), (_, right) = (ALIGN.update(ALIGN.initial_state(), c) for c in (mixed, changes))
    learnt = ours[0].t
    lost, twice = n - len(np.unique(learnt)), len(learnt) - len(np.unique(learnt))
    same = all(
        getattr(ours[0], name).tobytes() == getattr(right[0], name).tobytes()
        for name in ("t", "U", "p1", "p2", "Q", "T")
    )
    return f"{lost} of {n} | {twice} | {0 if same else 'all'} |"


async def line(served: tuple[NumberedServer, str], fault: str, seconds: float) -> str:
    """A line that is cut, flaps or stalls."""
    plant, _ = served
    async with watching(served, named=True) as (proxy, source, collector):
        await until(lambda: min(i.queue_size for i in source._subscription.watched.items) > 1_000)  # noqa: SLF001
        if fault == "cut":
            await proxy.cut_for(seconds)
        elif fault == "flapping":
            for _ in range(10):
                proxy.cut()
                await asyncio.sleep(seconds / 10)
        else:
            proxy.stall()
            await asyncio.sleep(seconds)
            proxy.flow()
        back, target = time.monotonic(), plant.written
        await until(lambda: collector.arrived[-1] > back, 60.0)
        again_s = next(t for t in collector.arrived if t > back) - back
        await until(lambda: collector.numbers[-1] >= target, 60.0)
        caught_up = seconds / (time.monotonic() - back)
        numbers = collector.numbers
        span = numbers[-1] - numbers[0] + 1
        lost, twice = span - len(set(numbers)), collector.counters.get("duplicates", 0)
    asked = f"; {caught_up:.0f} × real time" if source.counters.from_history else ""
    return f"{lost} of {span} | {twice} | | {again_s:.1f}{asked}"


def flips(count: int, seed: int) -> str:
    """Bits flipped in a file of states."""
    rng = np.random.default_rng(seed)
    states = {t: rng.bytes(3_000) for t in (1, 2)}
    names = [(valve, name) for valve in ("V1", "V2") for name in ("RLS", "RML", "RBF", "Auto")]
    newest, previous, fresh_ones, wrong, silent = 0, 0, 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state.sqlite"
        with CheckpointFile(file) as store:
            for t, state in states.items():
                store.save([Checkpoint(v, e, "k", t, state, 0.99, frozen=False) for v, e in names])
        whole = file.read_bytes()
        for _ in range(count):
            hurt = bytearray(whole)
            hurt[int(rng.integers(100, len(hurt)))] ^= 1 << int(rng.integers(8))
            file.write_bytes(hurt)
            with CheckpointFile(file) as store:
                loaded = store.load()
                wrong += any(c.state != states.get(c.t) for c in loaded)
                is_newest = len(loaded) == len(names) and {c.t for c in loaded} == {2}
                newest += is_newest
                previous += not is_newest and len(loaded) == len(names)
                fresh_ones += len(loaded) < len(names)
                silent += not (is_newest or store.damaged or store.set_aside)
                if store.set_aside is not None:
                    store.set_aside.unlink()
    return (
        f"{count} flips: {newest} newest, {previous} previous generation, {fresh_ones} in part "
        f"fresh, {wrong} wrong, {silent} silent, 0 crashes."
    )


def short_and_foreign(count: int, seed: int) -> str:
    """A file of states that is cut short, of another program, of the format before."""
    rng, wrong, silent, refused = np.random.default_rng(seed), 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state.sqlite"
        with CheckpointFile(file) as store:
            for t in (1, 2):
                state = bytes([t]) * 3_000
                store.save([Checkpoint("V1", e, "k", t, state, 0.99, frozen=False) for e in "abcd"])
        whole = file.read_bytes()
        for part in rng.integers(1, len(whole), count).tolist():
            file.write_bytes(whole[:part])
            with CheckpointFile(file) as store:
                loaded = store.load()
                wrong += any(c.state != bytes([c.t]) * 3_000 for c in loaded)
                silent += len(loaded) < 4 and not (store.damaged or store.set_aside)
                if store.set_aside is not None:
                    store.set_aside.unlink()
        for statement in ("PRAGMA user_version = 1", "PRAGMA application_id = 7"):
            file.write_bytes(whole)
            with closing(sqlite3.connect(file)) as other:
                other.execute(statement)
            try:
                with CheckpointFile(file) as store:
                    refused += store.set_aside is not None
            except StorageError:
                refused += 1
    return (
        f"cut short {count} times: {wrong} wrong, {silent} silent. Of the format before, of "
        f"another program: {refused} of 2 said."
    )


def out_of_range(count: int, seed: int) -> str:
    """One number of a stored state changed to an implausible one, under a valid digest."""
    rng, refused, crashes = np.random.default_rng(seed), 0, 0
    learnt = fresh()
    learnt.take_samples(0, samples_of(400))
    kept = [*learnt.states.checkpoints(), *learnt.states.memories()]
    for _ in range(count):
        k = int(rng.integers(len(kept)))
        record = np.load(io.BytesIO(kept[k].state), allow_pickle=False)
        arrays = [n for n in record.dtype.names if record[n].size and record[n].dtype.kind in "if"]
        name = arrays[int(rng.integers(len(arrays)))]
        array = record[name].copy()
        strange = (-1.0, 2.0**62) if array.dtype.kind == "i" else (np.nan, np.inf, -1e300)
        array.reshape(-1)[int(rng.integers(array.size))] = rng.choice(strange)
        record[name] = array
        file = io.BytesIO()
        np.save(file, record, allow_pickle=False)
        hurt = list(kept)
        hurt[k] = replace(kept[k], state=file.getvalue())
        again = fresh()
        try:
            refused += bool(again.restore(hurt)[1])
            again.take_samples(0, samples_of(50, first=400))
        except Exception:  # noqa: BLE001 - it is counted
            crashes += 1
    return f"{count} times: {refused} refused, {crashes} crashes."


def disorders(seed: int) -> Rows:
    """Samples out of order, doubled, sent again."""
    for text, delay_s, doubled, again_s in (
        ("reordered by up to 0.1 s", 0.1, False, 0.0),
        ("reordered by up to 0.9 s", 0.9, False, 0.0),
        ("everything twice", 0.0, True, 0.0),
        ("10 s sent again", 0.0, False, 10.0),
        ("all of these", 0.9, True, 10.0),
    ):
        yield text, disorder(delay_s, doubled=doubled, again_s=again_s, seed=seed)


async def lines(cuts: list[float]) -> list[tuple[str, str]]:
    """Lines that are cut, flap, stall."""
    users, password = UserStore.one_time("operator", Role.OPERATOR)
    plant = await NumberedServer.create(users=users, remembers=HISTORY)
    async with plant.server:
        served = plant, password
        cut = [(f"line cut for {s:g} s", await line(served, "cut", s)) for s in cuts]
        return [
            *cut,
            ("10 cuts in 5 s", await line(served, "flapping", 5.0)),
            ("stall of 20 s", await line(served, "stall", 20.0)),
        ]


def whole(kills: int, seed: int) -> Rows:
    """The whole service: killed, reloaded, started from a history."""
    account, unreadable = asyncio.run(reliability_lives.kills(kills, seed))
    lives = f" ({kills} kills, {unreadable} files unreadable)"
    yield "`valvemap serve` killed at random times", account.row(lives)
    yield (
        "reload, one valve of two changed: the other",
        asyncio.run(reliability_lives.reload()).row(),
    )
    yield (
        "start from 20 s of the source's history",
        asyncio.run(reliability_lives.warm_start()).row(),
    )


def forked(kills: int, seed: int) -> Rows:
    """Pipeline and storage, killed."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, forks.__file__, str(kills), str(seed), f"{folder}/state.sqlite"]
        env = {**os.environ, "PYTHONPATH": os.pathsep.join(("tests", "."))}
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
    found = json.loads(done.stdout)
    lives = f" ({kills} kills, {found['unreadable']} files unreadable)"
    learnt = found["samples"] - found["lost"]
    different = ("?",) * found["different"]
    account = Account(learnt, found["lost"], found["twice"], different)
    yield "pipeline and storage killed at random times", account.row(lives)


def damage(flipped: int, seed: int) -> Rows:
    """Files of states that are damaged, or hold what cannot be."""
    yield "bits flipped in kept states", flips(flipped, seed)
    yield "kept states cut short, foreign, of the format before", short_and_foreign(flipped, seed)
    yield "a number out of range under a valid digest", out_of_range(flipped, seed)


def slow(seconds: float) -> Rows:
    """A disk whose every sync takes 2 s longer."""
    for valves, hz in ((1, 100.0), (1_000, 2.0)):
        found = asyncio.run(reliability_load.slow_disk(valves, hz, seconds))
        yield f"sync + 2 s, {valves:,} valves x {hz:g} Hz", str(found)


def long(valves: int, hz: float, seconds: float, *, half: bool) -> Rows:
    """Many valves for long; with ``half`` the service has half a processor."""
    found = asyncio.run(reliability_load.soak(valves, hz, seconds, half=half))
    stopped = ", stopped and continued every 50 ms" if half else ""
    yield f"{valves:,} valves x {hz:g} Hz{stopped}", f"{seconds:g} s: {found}"


def merged(page: str, head: str, rows: Iterable[tuple[str, str]]) -> str:
    """The page with these rows in the table of this head, in place of those of the same name.

    >>> page = "Text.\\n\\n| fault | lost |\\n|---|---|\\n| cut | 0 |\\n| stall | 1 |\\n\\nMore.\\n"
    >>> print(merged(page, "| fault | lost |", [("stall", "3"), ("flood", "0")]))
    Text.
    <BLANKLINE>
    | fault | lost |
    |---|---|
    | cut | 0 |
    | stall | 3 |
    | flood | 0 |
    <BLANKLINE>
    More.
    <BLANKLINE>
    """
    before, found, rest = page.partition(f"{head}\n")
    table, gap, after = rest.partition("\n\n")
    rule, *old = table.splitlines()
    known = {line.strip("| ").partition(" | ")[0]: line for line in old}
    known |= {name: f"| {name} | {cells} |" for name, cells in rows}
    return before + found + "\n".join([rule, *known.values()]) + (gap or "\n") + after


SUBJECTS = ("order", "lines", "whole", "forks", "damage", "disk", "soak", "half")


def main() -> None:
    """Measure, and write each row into the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=SUBJECTS, default=SUBJECTS[:6])
    parser.add_argument(
        "--cuts", type=float, nargs="+", default=[1.0, 10.0, 45.0, 300.0], metavar="S"
    )
    parser.add_argument("--kills", type=int, default=60, help="of the whole service")
    parser.add_argument("--forks", type=int, default=950, help="of pipeline and storage")
    parser.add_argument("--flips", type=int, default=300)
    parser.add_argument("--valves", type=int, default=1_000, help="of the long runs")
    parser.add_argument("--hz", type=float, default=10.0, help="of the long runs")
    parser.add_argument(
        "--hour",
        type=float,
        nargs="?",
        const=3_600.0,
        metavar="SECONDS",
        help="the long run alone, an hour; with --only half stopped and continued",
    )
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    seconds = 60.0 if given.hour is None else given.hour
    chosen = given.only
    if given.hour is not None and chosen == SUBJECTS[:6]:
        chosen = ("soak",)
    subjects: dict[str, tuple[str, Callable[[], Rows]]] = {
        "order": (FAULTS, lambda: disorders(given.seed)),
        "lines": (FAULTS, lambda: asyncio.run(lines(given.cuts))),
        "whole": (FAULTS, lambda: whole(given.kills, given.seed)),
        "forks": (FAULTS, lambda: forked(given.forks, given.seed)),
        "damage": (LOADS, lambda: damage(given.flips, given.seed)),
        "disk": (LOADS, lambda: slow(30.0)),
        "soak": (LOADS, lambda: long(given.valves, given.hz, seconds, half=False)),
        "half": (LOADS, lambda: long(given.valves, given.hz, seconds, half=True)),
    }
    for name in chosen:
        head, measured = subjects[name]
        for row in measured():
            print(" | ".join(row), flush=True)
            page = merged(PAGE.read_text(encoding="utf-8"), head, [row])
            PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
