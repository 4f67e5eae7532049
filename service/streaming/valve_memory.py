"""All that a valve remembers beside its estimators' states, as bytes: gate, alignment, demand."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from service.identification.estimator import State, StateMismatchError
from service.streaming.kernels.gate import Memory
from service.streaming.kernels.waiting import Waiting
from service.streaming.pipeline import ValveState
from service.streaming.quality_gate import GateState


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
    def from_bytes(cls, data: bytes, key: str) -> "ValveMemory":
        """Unpack it.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged or belong to a valve whose samples go through something else.
        """
        kept = _Kept.from_bytes(data, key)
        try:
            gate = (kept.last, kept.last_time, kept.still_since, kept.window, kept.gate_counters)
            return cls(
                gate=GateState(Memory(*gate), kept.bad_status),
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
