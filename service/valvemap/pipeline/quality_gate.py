"""The quality gate: which samples the estimators may use."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from valvemap.model.samples import Samples, Segments, Times
from valvemap.pipeline.kernels import gate as kernel
from valvemap.pipeline.kernels.gate import Limits, Memory
from valvemap.vocabulary.signals import COUNT, SENSORS, Signal

COUNTER_NAMES = ("bad_status", "not_finite", "out_of_range", "frozen", "too_fast", "spike")


@dataclass(frozen=True)
class SignalLimits:
    """Limits of one signal, in its own unit; every check but the range is off unless given.

    Attributes
    ----------
    low, high : float
        Range outside of which a value is not a measurement.
    frozen_s : float
        A value that is bitwise constant for longer is that of a frozen sensor; 0 = off.
    max_rate_per_s : float
        Steepest change from one sample to the next; inf = off.
    spike : float
        Largest distance from the median of the last five values; inf = off.
    """

    low: float
    high: float
    frozen_s: float = 0.0
    max_rate_per_s: float = np.inf
    spike: float = np.inf


@dataclass(frozen=True)
class GateState:
    """State of the gate for M valves; all arrays of constant size, ``bad_status`` (M,)."""

    memory: Memory
    bad_status: Times

    def of(self, valves: slice) -> "GateState":
        """Return copies of the state of the given valves."""
        memory = Memory._make(array[valves].copy() for array in self.memory)
        return GateState(memory, self.bad_status[valves].copy())

    def view(self, valves: slice) -> "GateState":
        """Return the state of the given valves, not copied."""
        memory = Memory._make([array[valves] for array in self.memory])
        return GateState(memory, self.bad_status[valves])

    def put(self, m: int, other: "GateState") -> None:
        """Replace the state of valve ``m`` by that of the first valve of ``other``."""
        for own, array in zip(self.memory, other.memory, strict=True):
            own[m] = array[0]
        self.bad_status[m] = other.bad_status[0]

    def counts(self, chosen: Times) -> Times:
        """Rejections of K valves since the start; a sample may count under several reasons."""
        rejected = self.memory.counters[chosen].sum(axis=1)
        return np.column_stack((self.bad_status[chosen], rejected))

    @property
    def counters(self) -> Mapping[str, int]:
        """Rejections of the first valve by reason."""
        return dict(zip(COUNTER_NAMES, self.counts(np.zeros(1, np.int64))[0].tolist(), strict=True))


@dataclass(frozen=True)
class QualityGate:
    """Judges the samples of valves: status, NaN and inf, range; optionally frozen, rate, spike.

    Samples of UNCERTAIN status pass if ``use_uncertain``, else they become BAD. NaN of an
    optional signal is an absent reading, not a fault: maps without it are not affected.

    Examples
    --------
    >>> gate = QualityGate()
    >>> samples = Samples.of(
    ...     t=[0, 1], U=[50, np.nan], p1=[200, 200], p2=[0, 0], Q=[150, 150], T=[40, 40]
    ... )
    >>> state, judged = gate.update(gate.initial_state(), samples)
    >>> judged.quality.tolist(), state.counters["not_finite"]
    ([0, 2], 1)
    """

    limits: Mapping[Signal, SignalLimits] = field(
        default_factory=lambda: {s: SignalLimits(*s.plausible) for s in SENSORS}
    )
    use_uncertain: bool = False

    def initial_state(self, valves: int = 1) -> GateState:
        """Return the state before the first sample."""
        n = valves, COUNT
        return GateState(
            Memory(
                last=np.full(n, np.nan),
                last_time=np.zeros(n, np.int64),
                still_since=np.zeros(n, np.int64),
                window=np.full((*n, kernel.WINDOW), np.nan),
                counters=np.zeros((*n, kernel.REASONS), np.int64),
            ),
            np.zeros(valves, np.int64),
        )

    def update(self, state: GateState, samples: Samples) -> tuple[GateState, Samples]:
        """Judge N samples of one valve; only their quality changes."""
        after = state.of(slice(None))
        return after, self.judge(after, samples, Segments.one(len(samples)))

    def judge(self, state: GateState, samples: Samples, segments: Segments) -> Samples:
        """Judge N samples of many valves; ``state`` is updated in place."""
        quality = samples.quality.copy()
        kernel.judge_samples(
            samples.t,
            samples.values,
            self._limits,
            state.memory,
            quality,
            state.bad_status,
            self.use_uncertain,
            segments,
        )
        return replace(samples, quality=quality)

    @cached_property
    def _limits(self) -> Limits:
        limits = [self.limits[signal] for signal in SENSORS]
        return Limits(
            low=np.array([limit.low for limit in limits], np.float64),
            high=np.array([limit.high for limit in limits], np.float64),
            frozen_ns=np.array([limit.frozen_s * 1e9 for limit in limits]).astype(np.int64),
            max_rate=np.array([limit.max_rate_per_s for limit in limits], np.float64),
            spike=np.array([limit.spike for limit in limits], np.float64),
        )
