"""From the bytes of a PublishResponse to parameters: ``python -m benchmarks.pipeline_speed``.

One core, CPU time, everything that the live service does between the wire and the parameters:
decoding, alignment, gate, estimators, scores.
"""

import cProfile
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from valvemap.app.replay import replay
from valvemap.config.estimators import RlsConfig
from valvemap.config.loading import load_config
from valvemap.model.estimator import Estimator
from valvemap.model.forgetting import Adaptive
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.opcua_source.decoding import decode_publish_response
from valvemap.opcua_source.timestamps import EPOCH_TICKS
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.storage.recording_writer import RecordingWriter

SIGNALS, STRIDE = 5, 6
START, SPACING = 1_700_000_000_000_000_000, 10_000_000  # ns
MESSAGES, WARM = 14, 4
AGE = 40_000  # samples of a valve after which its map is compared at the longest interval

DOUBLE, INT32, BAD = 11, 6, 0x80000000
RECORD = np.dtype(
    [("handle", "<u4"), ("mask", "u1"), ("type", "u1"), ("value", "<f8"), ("source", "<i8")]
)
ODD = np.dtype(
    [("handle", "<u4"), ("mask", "u1"), ("type", "u1"), ("value", "<i4"), ("source", "<i8")]
)
MARKED = np.dtype(
    [
        ("handle", "<u4"),
        ("mask", "u1"),
        ("type", "u1"),
        ("value", "<f8"),
        ("status", "<u4"),
        ("source", "<i8"),
    ]
)

Estimators = Callable[[], dict[str, Estimator]]
Figures = dict[str, float]


def rls() -> dict[str, Estimator]:
    return {"RLS": RecursiveLeastSquares(forgetting=Adaptive())}


def three() -> dict[str, Estimator]:
    return {**rls(), "RML": MaximumLikelihood(lam=0.999), "RBF": RbfNetwork()}


def service(valves: int, estimators: Estimators) -> Identification:
    plans = [ValvePlan(f"V{v}", QualityGate(), estimators(), "RLS") for v in range(valves)]
    return Identification(plans, Alignment(AlignmentSettings(), (("T",),) * valves))


def rate(valves: int, each: int, estimators: Estimators, odd: float = 0.0, age: int = 0) -> float:
    """Notifications per second of CPU time; ``each`` samples of every valve in a message.

    The median of the messages; ``odd`` is the share that is Bad or of another type, ``age`` how
    many samples of each valve have been learnt from before.
    """
    identification = service(valves, estimators)
    rng = np.random.default_rng(0)
    if age:
        identification.restore(_as_if_aged(valves, age, estimators, rng))
    times = []
    for k in range(MESSAGES):
        message = _message(valves, each, age + k * each, odd, rng)
        start = time.process_time()
        changes = decode_publish_response(message).message.changes
        identification.take(changes)
        times.append(time.process_time() - start)
    return valves * each * SIGNALS / float(np.median(times[WARM:]))


def bytes_to_parameters() -> Figures:
    """Notifications per second of 1,000 valves, ten samples of each in a message."""
    return {
        "RLS": rate(1000, 10, rls),
        "RLS, a sample each": rate(1000, 1, rls),
        "RLS, 1 % Bad or odd": rate(1000, 10, rls, odd=0.01),
        "RLS, RML and RBF": rate(1000, 10, three),
    }


def profile() -> Figures:
    """Where the time goes, % of it: 1,000 valves, ten samples of each in a message, RLS."""
    identification = service(1000, rls)
    rng = np.random.default_rng(0)
    messages = [_message(1000, 10, k * 10, 0.0, rng) for k in range(MESSAGES)]
    profiler = cProfile.Profile(time.process_time)
    for k, message in enumerate(messages):
        if k == WARM:
            profiler.enable()
        identification.take(decode_publish_response(message).message.changes)
    profiler.disable()
    spent: dict[str, float] = {}
    for entry in profiler.getstats():
        code = entry.code
        where = code if isinstance(code, str) else f"{Path(code.co_filename).stem}.{code.co_name}"
        spent[where] = spent.get(where, 0.0) + entry.inlinetime
    total = sum(spent.values())
    most = sorted(spent.items(), key=lambda item: -item[1])[:8]
    return {name.split("_0x")[0]: 100.0 * seconds / total for name, seconds in most}


def scaling(each: Callable[[int], int]) -> Figures:
    """Time per sample, ns, of 10 to 10,000 valves; ``each``: samples of a valve in a message.

    The valves are of one age: a new one is compared more often, whatever their number.
    """
    return {
        f"{valves:,} valves": SIGNALS * 1e9 / rate(valves, each(valves), rls, age=AGE)
        for valves in (10, 100, 1_000, 10_000)
    }


def memory() -> Figures:
    """Resident kB per valve, by the difference of 10,000 and 1,000 valves after 20 samples."""
    kept, sizes = [], {}
    for valves in (1_000, 10_000):
        before = resident()
        identification = service(valves, rls)
        rng = np.random.default_rng(0)
        for k in range(20):
            identification.take(_changes(valves, 1, k, rng))
        sizes[valves] = resident() - before
        kept.append(identification)
    return {"kB per valve": (sizes[10_000] - sizes[1_000]) / 9_000}


def replayed(n: int, folder: Path) -> Figures:
    """Samples per second of wall time, Parquet to a verdict, and growth of the memory in MB."""
    file = folder / "recording.parquet"
    rng = np.random.default_rng(0)
    with RecordingWriter(file) as writer:
        for k in range(0, n, 100_000):
            U, dp = rng.uniform(0, 100, 100_000), rng.uniform(1, 200, 100_000)
            Q = 1 + 0.12 * U * np.sqrt(dp) + rng.normal(size=len(U))
            t = START + SPACING * np.arange(k, k + len(U))
            writer.append("Valvistor", Samples.of(t, U, 200.0 + 0 * U, 200.0 - dp, Q, 40.0 + 0 * U))
    config = load_config()
    (valve,) = config.valves
    alone = {"estimators": (RlsConfig(),), "inverse": "RLS"}
    config = config.model_copy(update={"valves": (valve.model_copy(update=alone),)})
    replay([file], config)  # compiles, fills the cache of the disk
    before, start = resident(), time.perf_counter()
    replay([file], config)
    took = time.perf_counter() - start
    return {"samples/s": n / took, "MB more": (resident() - before) / 1024}


def all_figures(replayed_samples: int = 10_000_000) -> dict[str, Figures]:
    """Every figure of this file."""
    with tempfile.TemporaryDirectory() as folder:
        return {
            "Bytes to parameters, notifications/s": bytes_to_parameters(),
            "Where the time goes, %": profile(),
            "Time per sample, ns, 100,000 samples in a message": scaling(lambda v: 100_000 // v),
            "Time per sample, ns, 10,000 samples in a message": scaling(lambda v: 10_000 // v),
            "Time per sample, ns, ten samples of each valve": scaling(lambda _: 10),
            "Memory, RLS alone": memory(),
            "Replay, RLS alone": replayed(replayed_samples, Path(folder)),
        }


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    for title, values in all_figures(*map(int, arguments)).items():
        print(title)
        for name, value in values.items():
            print(f"  {name:24} {value:16,.1f}")
    return 0


def _as_if_aged(
    valves: int, age: int, estimators: Estimators, rng: np.random.Generator
) -> list[Checkpoint]:
    """Checkpoints of this number of learnt valves: copies of ten."""
    few = service(min(valves, 10), estimators)
    for first in range(0, age, 1_000):
        few.take(_changes(len(few.plans), min(1_000, age - first), first, rng))
    kept = [few.states.kept([v]) for v in range(len(few.plans))]
    return [
        replace(checkpoint, valve=f"V{v}")
        for v in range(valves)
        for checkpoint in kept[v % len(kept)]
    ]


def _changes(valves: int, each: int, first: int, rng: np.random.Generator) -> DataChanges:
    n = valves * each
    U, dp = rng.uniform(0, 100, n), rng.uniform(1, 200, n)
    Q = 1 + 0.02 * U + 0.3 * np.sqrt(dp) + 0.12 * U * np.sqrt(dp) + rng.normal(size=n)
    values = np.stack([U, np.full(n, 200.0), 200.0 - dp, Q, np.full(n, 40.0)], axis=1)
    items = (np.arange(valves)[:, None] * STRIDE + np.arange(SIGNALS)).ravel()
    t = START + SPACING * np.repeat(np.arange(first, first + each), valves * SIGNALS)
    zeros = np.zeros(n * SIGNALS, np.uint32)
    return DataChanges(np.tile(items, each).astype(np.int32), values.ravel(), zeros, t)


def _message(valves: int, each: int, first: int, odd: float, rng: np.random.Generator) -> bytes:
    """A PublishResponse: handle, mask, type, Double, source time; odd ones otherwise."""
    changes = _changes(valves, each, first, rng)
    plain = _records(changes, RECORD, 0x05, DOUBLE)
    parts = [plain.tobytes()]
    if odd > 0.0:
        wrong = np.flatnonzero(rng.random(len(changes)) < odd)
        parts, done = [], 0
        for k in wrong.tolist():
            parts.append(plain[done:k].tobytes())
            kind = (ODD, 0x05, INT32) if k % 2 else (MARKED, 0x07, DOUBLE)
            parts.append(_records(changes[slice(k, k + 1)], *kind).tobytes())
            done = k + 1
        parts.append(plain[done:].tobytes())
    body = struct.pack("<i", len(changes)) + b"".join(parts) + struct.pack("<i", -1)
    time_ = int(changes.source_time[-1]) // 100 + EPOCH_TICKS
    return b"".join(
        [
            struct.pack("<BBH", 1, 0, 829),
            struct.pack("<qIIBi", time_, 1, 0, 0, 0) + bytes(3),
            struct.pack("<IiB", 1, 0, 0),
            struct.pack("<Iqi", 1, time_, 1),
            struct.pack("<BBHBi", 1, 0, 811, 1, len(body)) + body,
            struct.pack("<ii", 0, 0),
        ]
    )


def _records(changes: DataChanges, kind: np.dtype, mask: int, type_: int) -> np.ndarray:
    records = np.zeros(len(changes), kind)
    records["handle"], records["mask"], records["type"] = changes.item, mask, type_
    records["value"] = changes.value
    records["source"] = changes.source_time // 100 + EPOCH_TICKS
    if kind is MARKED:
        records["status"] = BAD
    return records


def resident() -> float:
    """Resident memory of this process, kB; NaN where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    except OSError:
        return float("nan")
    return pages * 4.0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
