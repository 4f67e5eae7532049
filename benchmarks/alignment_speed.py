"""Processor time of sorting changes into samples: ``python -m benchmarks.alignment_speed``.

CPU time per change, ns, of ``Alignment.take`` on one core, the best of many batches, compiled
before. A sample has five signals and, where samples are numbered, its number.
"""

import sys
import time

import numpy as np

from valvemap.model.samples import Times
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges

SIGNALS, STRIDE = 5, 6
START, SPACING = 1_700_000_000_000_000_000, 10_000_000  # ns
CHANGES, BATCHES = 60_000, 25  # in a batch
QUEUE = 10  # samples that one notification holds of each signal
DELAY = 5.0  # samples

Figures = dict[str, float]


def measured() -> Figures:
    """Time per change, ns."""
    return {
        "numbered, 1,000 valves": per_change(1_000),
        "numbered, one valve": per_change(1),
        "by time, 1,000 valves": per_change(1_000, numbered=False),
        "by time, one valve": per_change(1, numbered=False),
        "numbered, 1,000 valves, ten of a signal in a row": per_change(1_000, order="queues"),
        "by time, 1,000 valves, ten of a signal in a row": per_change(
            1_000, numbered=False, order="queues"
        ),
        "numbered, 1,000 valves, each delayed by up to 50 ms": per_change(1_000, order="delays"),
    }


def per_change(valves: int, *, numbered: bool = True, order: str = "samples") -> float:
    """Time per change, ns, that come sample by sample, or by ``queues``, or after ``delays``."""
    align = Alignment(AlignmentSettings(), (("T",),) * valves, (numbered,) * valves)
    signals = STRIDE if numbered else SIGNALS
    each = max(1, CHANGES // signals // valves)
    rng = np.random.default_rng(0)
    waiting, times, left = align.initial_state(), [], 0
    for batch in range(BATCHES):
        sample = np.repeat(np.arange(batch * each, (batch + 1) * each), valves * signals)
        item = np.tile((np.arange(valves)[:, None] * STRIDE + np.arange(signals)).ravel(), each)
        value = np.where(item % STRIDE == SIGNALS, sample, rng.uniform(0, 100, len(item)))
        arrival = _arrival(order, sample, item, rng)
        changes = DataChanges(
            item[arrival].astype(np.int32),
            value[arrival],
            np.zeros(len(item), np.uint32),
            START + SPACING * sample[arrival],
        )
        start = time.process_time()
        waiting, samples = align.take(waiting, changes)
        times.append((time.process_time() - start) / len(changes))
        left += len(samples.samples.t)
    if left != BATCHES * each * valves:
        raise RuntimeError(f"{left} of {BATCHES * each * valves} samples")
    return min(times[1:]) * 1e9


def _arrival(order: str, sample: Times, item: Times, rng: np.random.Generator) -> Times:
    if order == "queues":
        return np.lexsort((sample, item, sample // QUEUE))
    delay = rng.uniform(0, DELAY, len(item)) if order == "delays" else 0.0
    return np.argsort(sample + delay, kind="stable")


def main() -> int:
    """Measure and print."""
    for name, ns in measured().items():
        print(f"{name:52} {ns:8.1f} ns")
    return 0


if __name__ == "__main__":
    sys.exit(main())
