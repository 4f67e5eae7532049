"""What compiles the kernels: every kind of computation, once on a few synthetic samples."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from valvemap.app.build import alignment_of, build_identification, build_plans
from valvemap.config.meters import meters_of
from valvemap.config.models import Config
from valvemap.model import flow_map_warm_up, spool_model
from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.capabilities import ChoosesStructure, FindsChanges
from valvemap.model.estimator import Estimator, key_of
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Samples, Segments, Trace
from valvemap.model.shared_meter import SharedMeter
from valvemap.model.support import Support
from valvemap.opcua_source.decoding import decode_data_changes
from valvemap.pipeline.alarm_rules import RULES
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels import lanes
from valvemap.pipeline.places import Places
from valvemap.pipeline.plausibility import Plausibility
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.score import Score
from valvemap.pipeline.valve_timing import make_one_scan

_NO_CHANGES = bytes(4) + b"\xff" * 4  # a DataChangeNotification: no items, no diagnostics
_ONE_CHANGE = DataChanges(
    item=np.zeros(1, np.int32),
    value=np.zeros(1),
    status=np.zeros(1, np.uint32),
    source_time=np.zeros(1, np.int64),
)


def parts_of(config: Config) -> list[Callable[[], None]]:
    """Return the parts to compile separately, the longest first; they share hardly any kernel."""
    estimators = {
        key_of(estimator): estimator
        for plan in build_plans(config)
        for estimator in plan.estimators.values()
    }
    finds_structure = any(isinstance(one, ChoosesStructure) for one in estimators.values())
    others = [one for one in estimators.values() if not isinstance(one, ChoosesStructure)]
    return [
        *((flow_map_warm_up.learn, flow_map_warm_up.fit) if finds_structure else ()),
        *(partial(_learn, one) for one in others if isinstance(one, FindsChanges)),
        *(partial(_learn, one) for one in others if not isinstance(one, FindsChanges)),
        partial(compile_alignment, config),
        _look_around,
        _watch,
        _compare,
        partial(_first_maps, config),
        *((flow_map_warm_up.look, flow_map_warm_up.begin_again) if finds_structure else ()),
        *((_learn_axis,) if config.axes else ()),
        *((_fit_dynamics,) if config.dynamics.share else ()),
        *((_share_a_meter,) if meters_of(config.valves) else ()),
    ]


def _share_a_meter() -> None:
    """Compile the division of a flow among valves."""
    meter, one = SharedMeter(((0.0, 100.0), (0.0, 100.0))), np.ones((2, 1))
    meter.learn(meter.initial_state(), one, one, one[0], np.ones(1, np.bool_))


def _learn_axis() -> None:
    """Compile the regression of axes."""
    regression, line = AxisRegression(AxisGeometry(63.0, 45.0, 800.0, 1.2, 1.2)), _samples()
    samples = AxisSamples.of(
        line.t, U=line.U, x=line.Q, pA=line.p2, pB=line.p2, pS=line.p1, pT=line.T
    )
    regression.update(regression.initial_state(), samples)
    axis = Axis(AxisPlan("", regression.geometry))
    axis.take_line(0, line)
    axis.take_line(1, line)


def _fit_dynamics() -> None:
    """Compile the fit of dynamics."""
    few = _samples()
    grid = spool_model.Grid(
        few.T, few.U, few.p1, few.Q, 1e-2, 40, spool_model.Hold.CONSTANT, (0.0, 5.0, 1.0)
    )
    point = spool_model.Point(10.0, 0.7, spool_model.NO_SLEW, 0.0, 0.01, 1.0)
    spool_model.residual(grid, point)
    spool_model.response(point, 1.0, 0.01)


def _learn(estimator: Estimator[Any]) -> None:
    state, _ = estimator.update(estimator.initial_state(), _samples())
    estimator.predict(state, *(np.full(1, x) for x in (50.0, 100.0, 40.0)))
    estimator.parameters(state)


def compile_alignment(config: Config) -> None:
    """Compile decoding and alignment, all that `record` needs."""
    decode_data_changes(_NO_CHANGES)
    alignment = alignment_of(config, ((),), (False,))
    waiting, _ = alignment.take(alignment.initial_state(), _ONE_CHANGE)
    alignment.waits(waiting)
    make_one_scan()


def _first_maps(config: Config) -> None:
    """Compile the inverse map, which is published before the first sample."""
    build_identification(config)


def _look_around() -> None:
    """Compile plausibility, quality gate, support and residual spread."""
    samples, one = _samples(), Segments.one(len(_samples()))
    Plausibility(1).count(samples, one)
    gate = QualityGate()
    gate.judge(gate.initial_state(1), samples, one)
    support = Support.none().of_many(1)
    status = np.zeros(len(samples), np.uint8)
    support.learn(samples, status, one)
    rests, U, dp, T = support.one(0), *(np.full(1, x) for x in (50.0, 100.0, 40.0))
    rests.distance(U, dp, T)
    rests.misfit(U, dp, U)
    rests.may_hide(U, dp)
    spread = ResidualSpread.none().add(samples, Trace(samples.Q, samples.Q, samples.Q, status))
    spread.half_width(U, dp, U)


def _compare() -> None:
    """Compile the comparison of estimators at places, for one valve."""
    samples, places = _samples(), Places(1, 1)
    errors, status = np.zeros((1, len(samples))), np.zeros((1, len(samples)), np.uint8)
    places.learn(samples, errors, errors, status, Segments.one(len(samples)))
    places.of(0, 0).widened(samples.U, samples.U, samples.dp, samples.T)


def _watch() -> None:
    """Compile alarms, scores and the bookkeeping of lanes."""
    samples, one = _samples(), Segments.one(len(_samples()))
    trace = Trace(samples.Q, samples.Q, samples.Q, np.zeros(len(samples), np.uint8))
    alarms = Alarms(1, RULES, 200.0)
    alarms.watch(samples, trace, one)
    alarms.note_answers(np.zeros(1, np.int64), np.zeros(1))
    Score.none().add(samples, trace)
    lanes.note(samples.t, trace.predicted, trace.residual, trace.status, lanes.nothing(1), one)
    lanes.last_T(samples.T, samples.quality, np.full(1, np.nan), one)


def compile_here(config: Config) -> None:
    """Run every kind of pipeline once on synthetic samples; the results are discarded."""
    compile_alignment(config)  # called directly: at first the timing holds changes back
    _look_around()
    if config.axes:
        _learn_axis()
    if config.dynamics.share:
        _fit_dynamics()
    if meters_of(config.valves):
        _share_a_meter()
    identification = build_identification(config)
    if config.valves:
        identification.take(_ONE_CHANGE)
    identification.arrivals.waits()
    for valve in identification.valves.one_of_each_kind():
        plan = identification.plans[valve]
        identification.take_samples(valve, _samples())
        for estimator in plan.estimators:
            identification.predict(plan.name, estimator, 50.0, 100.0, 40.0)
            identification.predict_measurement(plan.name, estimator, 50.0, 100.0, 40.0)
            support, one = (
                identification.valves.lane(plan.name, estimator).support,
                np.full(1, 50.0),
            )
            support.misfit(one, one, one)  # the samples decide which kernels a map needs
            support.may_hide(one, one)
        identification.results.one(valve)
    identification.maps.refresh()
    plans = identification.plans
    if any(isinstance(one, ChoosesStructure) for plan in plans for one in plan.estimators.values()):
        flow_map_warm_up.look()
        flow_map_warm_up.begin_again()


def _samples() -> Samples:
    n = 32
    k = np.arange(n, dtype=np.float64)
    U, dp = (37.0 * k) % 100.0, (1.0 + 61.0 * k) % 200.0
    return Samples.of(
        t=np.arange(n), U=U, p1=np.full(n, 200.0), p2=200.0 - dp, Q=U * np.sqrt(dp) / 10, T=0 * U
    )
