"""All that a valve remembers beside its estimators' states, as bytes: gate, alignment, demand."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.kept_waiting import contents_of_waiting
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.gate import Memory
from valvemap.pipeline.kernels.waiting import Waiting
from valvemap.pipeline.quality_gate import GateState, QualityGate
from valvemap.pipeline.valve_state import ValveState
from valvemap.vocabulary.statuses import Status

_MOST_SAMPLES = 2.0**53  # that a float counts exactly


@dataclass(frozen=True)
class _Kept(State):
    """As it goes into a checkpoint; ``lanes`` (E, 4) has a row for each of ``names``."""

    last: Any
    last_time: Any
    still_since: Any
    window: Any
    gate_counters: Any
    bad_status: Any
    slots: Any
    values: Any
    status: Any
    held_value: Any
    held_status: Any
    held_time: Any
    lost: Any
    left: Any
    order: Any
    counters: Any
    moment: Any
    T: Any
    demand: Any
    names: Any
    lanes: Any

    @classmethod
    def like(cls, other: Self, gate: QualityGate, alignment: Alignment) -> Self:
        """Of a valve that has seen nothing, with as many samples and estimators as another."""
        waiting = alignment.nothing(1, _length(other.slots, 1))
        waiting.order[0, slots.SIZE] = _length(other.slots, 1)
        memory, names = gate.initial_state(1), np.asarray(other.names)
        nothing = np.full(2, np.nan)
        return cls(
            *memory.memory,
            memory.bad_status,
            *waiting,
            moment=np.array(0),
            T=nothing[0],
            demand=nothing,
            names=names,
            lanes=np.zeros((_length(names, 0), 4)),
        )

    def contents(self) -> Mapping[str, Contents]:
        """What may stand in them; ``order`` says that all that is kept waits."""
        waiting = Waiting(*(getattr(self, name) for name in Waiting._fields))
        found = contents_of_waiting(waiting)
        for name in ("last", "window", "T", "demand"):
            found[name] = Contents(np.asarray(getattr(self, name))).or_nan()
        for name in ("last_time", "still_since", "moment"):
            found[name] = Contents(np.asarray(getattr(self, name))).any_time()
        lanes = Contents(self.lanes).within(0.0, _MOST_SAMPLES, (slice(None), 0))
        lanes.within(-1.0, float(max(Status)), (slice(None), 3)).or_nan((slice(None), [1, 2]))
        return {**found, "lanes": lanes}


def _length(array: Any, axis: int) -> int:  # noqa: ANN401 - whatever was kept
    shape: tuple[int, ...] = np.shape(array)
    if len(shape) <= axis:
        raise StateMismatchError("an array of another shape")
    return shape[axis]


@dataclass(frozen=True)
class LaneNotes:
    """What is noted of one estimator's last sample; ``status`` is -1 before the first."""

    beyond: int
    predicted: float
    residual: float
    status: int


@dataclass(frozen=True)
class ValveMemory:
    """What one valve remembers; gate and waiting are those of one valve, (1, …)."""

    gate: GateState
    waiting: Waiting
    t: int
    T: float
    demand: tuple[float, float]
    notes: dict[str, LaneNotes]

    @classmethod
    def of(cls, state: ValveState, waiting: Waiting, beyond: dict[str, int]) -> "ValveMemory":
        """Of a valve as it stands."""
        return cls(
            gate=state.gate,
            waiting=waiting,
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
        """Pack it; ``key`` names what the valve's samples go through."""
        memory = self.gate.memory
        notes = [
            (note.beyond, note.predicted, note.residual, note.status)
            for note in self.notes.values()
        ]
        return _Kept(
            last=memory.last,
            last_time=memory.last_time,
            still_since=memory.still_since,
            window=memory.window,
            gate_counters=memory.counters,
            bad_status=self.gate.bad_status,
            **self.waiting._asdict(),
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
        """Unpack it; ``gate`` and ``alignment`` are what the valve's samples go through.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, belong to a valve whose samples go through something else, or
            hold what cannot be.
        """
        kept = _Kept.from_bytes(data, key)
        kept.check(_Kept.like(kept, gate, alignment))
        try:
            of_gate = (kept.last, kept.last_time, kept.still_since, kept.window, kept.gate_counters)
            return cls(
                gate=GateState(Memory(*of_gate), kept.bad_status),
                waiting=Waiting(*(getattr(kept, name) for name in Waiting._fields)),
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
