"""What a fleet keeps of its valves' samples and demands beside the lanes. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from valvemap.model.estimator import key_of
from valvemap.model.samples import Floats, Samples, Segments, Times
from valvemap.pipeline.kernels import lanes as kernel
from valvemap.pipeline.quality_gate import GateState, QualityGate
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_state import Lane, ValveState


class FleetInputs:
    """The gate's state of M valves, their newest time and temperature, and their demands.

    Parameters
    ----------
    gate
        The valves' gate.
    M
        Number of valves.

    Attributes
    ----------
    gate : GateState
    t : int
        Time of each valve's newest sample (M,), UTC ns; 0: there is none.
    T : float
        Each valve's last measured temperature (M,), °C; NaN: there is none.
    demand : float
        Standing demands of flow and pressure drop (M, 2), l/min and bar; NaN: there is none.
    """

    def __init__(self, gate: QualityGate, M: int) -> None:
        self.gate: GateState = gate.initial_state(M)
        self.t: Times = np.zeros(M, np.int64)
        self.T: Floats = np.full(M, np.nan)
        self.demand: Floats = np.full((M, 2), np.nan)
        self._key = f"valve {key_of(gate)}"

    def note_newest(self, judged: Samples, running: Segments) -> None:
        """Note time and temperature of the newest of the gated samples."""
        self.t[running.members] = judged.t[running.stops - 1]
        kernel.last_T(judged.T, judged.quality, self.T, running)

    def state(self, m: int, lanes: Mapping[str, Lane]) -> ValveState:
        """Return the state of one valve with these lanes; a copy."""
        return self._state(m, self.gate.of(slice(m, m + 1)), lanes)

    def view(self, m: int, lanes: Mapping[str, Lane]) -> ValveState:
        """As `state`, not copied: the next samples change it."""
        return self._state(m, self.gate.view(slice(m, m + 1)), lanes)

    def put(self, m: int, gate: GateState, t: int, T: float) -> None:
        """Restore one valve's gate, newest time (UTC ns) and last temperature (°C)."""
        self.gate.put(m, gate)
        self.t[m], self.T[m] = t, T

    def columns(self, valves: Sequence[str]) -> Columns:
        """Return the arrays of the valves, not copied."""
        gate = {f"gate_{name}": array for name, array in self.gate.memory._asdict().items()}
        own = {"bad_status": self.gate.bad_status, "t": self.t, "T": self.T}
        return Columns(self._key, tuple(valves), {**gate, **own, "demand": self.demand})

    def _state(self, m: int, gate: GateState, lanes: Mapping[str, Lane]) -> ValveState:
        return ValveState(
            gate=gate,
            lanes=lanes,
            t=int(self.t[m]),
            T=float(self.T[m]),
            demand_Q=float(self.demand[m, 0]),
            demand_dp=float(self.demand[m, 1]),
        )
