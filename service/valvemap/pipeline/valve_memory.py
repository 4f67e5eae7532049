"""A valve's state beside its estimators', as bytes: gate, alignment, demand."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.arrivals import ArrivalsOfValve
from valvemap.pipeline.clock_steps import Known
from valvemap.pipeline.kept_arrivals import KeptArrivals, arrays_of_arrivals, length_of
from valvemap.pipeline.kernels.gate import Memory
from valvemap.pipeline.quality_gate import GateState, QualityGate
from valvemap.pipeline.valve_state import ValveState
from valvemap.vocabulary.statuses import Status

_TIMES = "last_time", "still_since", "moment"
_MOST_SAMPLES = 2.0**53  # largest count that a float represents exactly


@dataclass(frozen=True)
class _Kept(KeptArrivals):
    """The state as stored in a checkpoint; ``lanes`` (E, 4) has a row for each of ``names``."""

    state_version: ClassVar[int] = 3

    last: Any
    last_time: Any
    still_since: Any
    window: Any
    gate_counters: Any
    bad_status: Any
    moment: Any
    T: Any
    demand: Any
    names: Any
    lanes: Any

    @classmethod
    def like(cls, other: Self, gate: QualityGate, alignment: Alignment) -> Self:
        """Return an initial state with as many samples and estimators as ``other``."""
        names, nothing = np.asarray(other.names), np.full(2, np.nan)
        return cls(
            **_arrays_of_gate(gate.initial_state(1)),
            **other.arrivals_like(alignment),
            moment=np.array(0),
            T=nothing[0],
            demand=nothing,
            names=names,
            lanes=np.zeros((length_of(names, 0), 4)),
        )

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Add the start of the source and the step of its clock, which version 2 did not know."""
        if version != "2":
            return {}
        times, digests = Known.nothing()
        started = np.array(0)
        return arrays | {
            "source_started": started,
            "known_times": times,
            "known_digests": digests,
        }

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        found = dict(super().contents())
        for name in ("last", "window", "T", "demand"):
            found[name] = Contents(np.asarray(getattr(self, name))).or_nan()
        for name in _TIMES:
            found[name] = Contents(np.asarray(getattr(self, name))).any_time()
        lanes = Contents(self.lanes).within(0.0, _MOST_SAMPLES, (slice(None), 0))
        lanes.within(-1.0, float(max(Status)), (slice(None), 3)).or_nan((slice(None), [1, 2]))
        return {**found, "lanes": lanes}


@dataclass(frozen=True)
class LaneNotes:
    """Results of one estimator's last sample; ``status`` is -1 before the first."""

    beyond: int
    predicted: float
    residual: float
    status: int


@dataclass(frozen=True)
class ValveMemory:
    """State of one valve beside its estimators'; the gate has one row, (1, …)."""

    gate: GateState
    arrivals: ArrivalsOfValve
    t: int
    T: float
    demand: tuple[float, float]
    notes: dict[str, LaneNotes]

    @classmethod
    def of(
        cls, state: ValveState, arrivals: ArrivalsOfValve, beyond: dict[str, int]
    ) -> "ValveMemory":
        """Build it from the state of a valve."""
        return cls(
            gate=state.gate,
            arrivals=arrivals,
            t=state.t,
            T=state.T,
            demand=(state.demand_Q, state.demand_dp),
            notes={
                name: LaneNotes(
                    beyond[name],
                    lane.predicted,
                    lane.residual,
                    -1 if lane.status is None else int(lane.status),
                )
                for name, lane in state.lanes.items()
            },
        )

    def to_bytes(self, key: str) -> bytes:
        """Pack it; ``key`` is the hash of the valve's gate and alignment settings."""
        notes = [
            (note.beyond, note.predicted, note.residual, note.status)
            for note in self.notes.values()
        ]
        return _Kept(
            **_arrays_of_gate(self.gate),
            **arrays_of_arrivals(self.arrivals),
            moment=np.array(self.t),
            T=np.array(self.T),
            demand=np.array(self.demand),
            names=np.array(list(self.notes)),
            lanes=np.array(notes, np.float64),
        ).to_bytes(key)

    @classmethod
    def from_bytes(
        cls, data: bytes, key: str, gate: QualityGate, alignment: Alignment
    ) -> "ValveMemory":
        """Unpack it; ``gate`` and ``alignment`` are those of the valve.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, belong to another gate or alignment, or have invalid
            content.
        """
        kept = _Kept.from_bytes(data, key)
        kept.check(_Kept.like(kept, gate, alignment))
        try:
            of_gate = (kept.last, kept.last_time, kept.still_since, kept.window, kept.gate_counters)
            return cls(
                gate=GateState(Memory(*of_gate), kept.bad_status),
                arrivals=kept.arrivals(),
                t=int(kept.moment),
                T=float(kept.T),
                demand=(float(kept.demand[0]), float(kept.demand[1])),
                notes={
                    str(name): LaneNotes(int(row[0]), float(row[1]), float(row[2]), int(row[3]))
                    for name, row in zip(kept.names, kept.lanes, strict=True)
                },
            )
        except (ValueError, IndexError, TypeError, OverflowError) as error:
            raise StateMismatchError(f"not a valve's memory: {error}") from error


def _arrays_of_gate(gate: GateState) -> dict[str, Any]:
    memory = gate.memory
    return {
        "last": memory.last,
        "last_time": memory.last_time,
        "still_since": memory.still_since,
        "window": memory.window,
        "gate_counters": memory.counters,
        "bad_status": gate.bad_status,
    }
