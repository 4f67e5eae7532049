"""Recordings and true values for the report, from the virtual rig."""

import math
from typing import Final

import numpy as np

from paper.data import IdealValve, PaperData, Points
from valvemap.model.samples import Floats, Samples
from valvemap_rig.blocks import ValveBlock
from valvemap_rig.circuit import reachable, true_flow
from valvemap_rig.excitation import Cycle, Excitation, Scattered, Structured, Verification
from valvemap_rig.faults import Fault, FaultKind
from valvemap_rig.kernels import RHO_K
from valvemap_rig.oil import Oil, density
from valvemap_rig.scenario import Scenario, ValveBench
from valvemap_rig.simulation import advance, initial
from valvemap_rig.valvistor import Valvistor, poppet_state

DAMAGE_PERCENT: Final = -30.0
HOT_C: Final = 60.0
WIDE_LOOP_PERCENT: Final = 4.0
SLOW_PILOT_S: Final = 0.1

_BENCH = ValveBench()
_STILL = _BENCH.circuit.model_copy(update={"tank_drift_K": 0.0})
_IDEAL = Valvistor(
    jet_angle_deg=90,
    spring_preload_N=0,
    spring_rate_N_mm=0,
    pilot_jet_per_bar=0,
    poppet_transition_re=0,
    slot_transition_re=0,
    pilot_leakage_l_min_bar=0,
    seat_leakage_l_min_bar=0,
    stroke_mm=10,
    phi=3.0,
)


def measure(rate_hz: float = 10.0, seed: int = 1) -> PaperData:
    """Run the rig; each recording has the length of a structured pass, 11 levels of 20 s.

    Examples
    --------
    >>> data = measure(rate_hz=1.0)
    >>> len(data.structured), len(data.levels)
    (220, 11)
    """
    structured = Structured()
    levels = np.array(structured.levels_percent)
    n = round(len(levels) * structured.sweep_s * rate_hz)

    def record(excitation: Excitation, bench: ValveBench = _BENCH, *faults: Fault) -> Samples:
        return _samples(_run(excitation, bench, n, rate_hz, seed, *faults))

    damage = Fault(kind=FaultKind.DAMAGE, size=DAMAGE_PERCENT, start_s=n / rate_hz / 2)
    warming = _BENCH.circuit.model_copy(
        update={"tank_drift_K": 20.0, "tank_drift_period_s": n / rate_hz / 2}
    )
    wide = _BENCH.valve.model_copy(update={"hysteresis_percent": WIDE_LOOP_PERCENT})
    slow = _BENCH.valve.model_copy(update={"pilot_lag_s": SLOW_PILOT_S})
    working = _BENCH.model_copy(update={"circuit": _STILL, "valve": _smooth()})
    return PaperData(
        rate_hz=rate_hz,
        levels=levels,
        hysteresis=_BENCH.valve.hysteresis_percent,
        structured=record(structured),
        scattered=record(Scattered()),
        cycle=record(Cycle()),
        damaged=record(Scattered(), _BENCH, damage),
        warm=record(Scattered(), _BENCH.model_copy(update={"circuit": warming})),
        hysteretic=record(Scattered(), _BENCH.model_copy(update={"valve": wide})),
        lagging=record(Scattered(), _BENCH.model_copy(update={"valve": slow})),
        new=_truth(_STILL.tank_C),
        worn=_truth(_STILL.tank_C, Fault(kind=FaultKind.DAMAGE, size=DAMAGE_PERCENT)),
        hot=_truth(HOT_C),
        working=_points(_run(Cycle(variation=0), working, 400, 20.0, seed)),
        curves=_curves(levels),
        ideal=_ideal(),
    )


def measure_structured(rate_hz: float, seed: int = 1) -> Samples:
    """Record one structured pass.

    Examples
    --------
    >>> len(measure_structured(rate_hz=1.0))
    220
    """
    structured = Structured()
    n = round(len(structured.levels_percent) * structured.sweep_s * rate_hz)
    return _samples(_run(structured, _BENCH, n, rate_hz, seed))


def _run(
    excitation: Excitation, bench: ValveBench, n: int, rate_hz: float, seed: int, *faults: Fault
) -> ValveBlock:
    scenario = Scenario(
        seed=seed, sample_rate_hz=rate_hz, excitation=excitation, valves=(bench,), faults=faults
    )
    _, block = advance(scenario, initial(scenario, start_ns=0), n)
    return block.valves[bench.name]


def _samples(block: ValveBlock) -> Samples:
    return Samples.of(t=block.t, U=block.U, p1=block.p1, p2=block.p2, Q=block.Q, T=block.T)


def _points(block: ValveBlock) -> Points:
    return Points(block.U_true, block.dp_true, block.T_true, block.Q_true)


def _truth(T: float, *faults: Fault) -> Points:
    """Return the verification points that the pump can supply, without noise or hysteresis.

    They come from the simulation, not from `true_flow`, since it applies the faults.
    """
    circuit = _STILL.model_copy(update={"tank_C": T})
    bench = _BENCH.model_copy(update={"circuit": circuit, "valve": _smooth()})
    block = _run(Verification(), bench, 1000, 10.0, 1, *faults)
    return _points(block)[block.p1 >= circuit.p0_bar - circuit.relief_override_bar - 0.5]


def _smooth() -> Valvistor:
    return _BENCH.valve.model_copy(update={"hysteresis_percent": 0.0})


def _curves(levels: Floats) -> Points:
    U, dp = (x.ravel() for x in np.meshgrid(levels, np.linspace(0, 200, 101), indexing="ij"))
    Q = true_flow(_BENCH, U, dp)
    Q[~reachable(_BENCH, U, dp)] = np.nan
    return Points(U, dp, np.full_like(U, _STILL.tank_C), Q)


def _ideal() -> IdealValve:
    """Solve the paper's equations, without neglected effects; K includes the oil's density."""
    oil, p1, T = Oil(), 200.0, 40.0
    y, dp = (x.ravel() for x in np.meshgrid([0.01, 0.2, 0.4, 0.6, 0.8, 1.0], [20.0, 60.0, 180.0]))
    same = np.full_like(y, p1)
    state = poppet_state(_IDEAL, oil, y, same, same - dp, np.full_like(y, T), np.ones_like(y))
    lighter = math.sqrt(RHO_K / density(oil, np.array([p1]), np.array([T]))[0])
    return IdealValve(
        phi=_IDEAL.phi,
        K_MP=_IDEAL.K_MP * lighter,
        K_c=_IDEAL.K_c * lighter,
        K_PV=_IDEAL.K_PV * lighter,
        x_0=_IDEAL.x_0_mm,
        x_PV=_IDEAL.pilot_stroke_mm * y,
        dp=dp,
        Q_PV=state.Q_PV,
        x_MP=state.x_MP,
        Q=state.Q,
    )
