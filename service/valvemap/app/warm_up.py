"""Compiles every kernel in advance, so that no sample waits for the compiler."""

import atexit
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from multiprocessing.sharedctypes import Synchronized
from typing import Any, Final

import numpy as np

from valvemap.app.build import alignment_of, build_identification, build_plans
from valvemap.config.meters import meters_of
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.model import flow_map_warm_up, spool_fit
from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.capabilities import ChoosesStructure, FindsChanges
from valvemap.model.estimator import Estimator, key_of
from valvemap.model.kernels.compiled import take_shortcuts
from valvemap.model.kernels.warmed_up import note_warm_up, was_warmed_up
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Samples, Segments, Trace
from valvemap.model.shared_meter import SharedMeter
from valvemap.model.support import Support
from valvemap.numba_version import are_shortcuts_asked_for
from valvemap.opcua_source.decoding import decode_data_changes
from valvemap.pipeline.alarms import RULES, Alarms
from valvemap.pipeline.axes import Axis, AxisPlan
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


Progress = Callable[[int, int], None]  # parts done, parts in total
_REPORT_EVERY_S = 5.0
_POLL_S: Final = 0.5  # s; longest delay until a request to end is noticed
_MOST_HELPERS: Final = 2  # processes; a third finds little work, and each needs 150 MB
_NICENESS: Final = 5  # the service, which runs meanwhile, comes first
_OF_ONE = {"name", "nodes", "source", "identification"}  # fields without effect on the kernels


def warm_up(
    config: Config,
    progress: Progress = lambda _done, _of: None,
    is_over: Callable[[], bool] = lambda: False,
) -> None:
    """Compile every kernel that this configuration needs.

    The first run on a machine compiles for 40 s and caches the result on disk; later runs load it.
    Two processes share the parts, each taking the next free one. ``progress`` is called
    periodically with the number of parts done. No further part is started once ``is_over``
    returns True.
    """
    config = _one_of_each_kind(config)
    if not was_warmed_up():
        _compile_in_parts(config, progress, is_over)
    if is_over():
        return
    compile_here(config)
    note_warm_up()


def warm_up_aside(
    config: Config,
    progress: Progress = lambda _done, _of: None,
    is_over: Callable[[], bool] = lambda: False,
) -> None:
    """Compile every kernel in other processes of low priority, without use of this one's kernels.

    They share the parts as in `warm_up`, and are terminated as soon as ``is_over`` returns True.
    """
    config = _one_of_each_kind(config)
    if was_warmed_up():
        return
    of = len(_parts(config))
    with _helpers(config, min(os.cpu_count() or 1, _MOST_HELPERS), _NICENESS) as shared:
        while any(helper.is_alive() for helper in shared.helpers) and not is_over():
            progress(shared.done.value, of)
            wait([helper.sentinel for helper in shared.helpers if helper.is_alive()], _POLL_S)
        if is_over():
            for helper in shared.helpers:
                helper.terminate()
    if shared.done.value == of:
        note_warm_up()


def _one_of_each_kind(config: Config) -> Config:
    """Return the configuration with one valve of each kind, apart from names and nodes.

    Two are kept of those behind one meter, which share more than the kind.
    """
    kinds: dict[tuple[str, str], ValveConfig] = {}
    behind = meters_of(config.valves)
    two = [name for name, meter in behind.items() if meter == next(iter(behind.values()))][:2]
    for valve in config.valves:
        kind = valve.model_dump_json(exclude=_OF_ONE)
        kinds.setdefault((kind, valve.name if valve.name in two else ""), valve)
    return config.model_copy(update={"valves": tuple(kinds.values())})


def _compile_in_parts(config: Config, progress: Progress, is_over: Callable[[], bool]) -> None:
    """Compile the slow parts, each in one of two processes."""
    finished, of = threading.Event(), len(_parts(config))
    with _helpers(config, min((os.cpu_count() or 1) - 1, 1), 0) as shared:

        def report() -> None:
            while not finished.wait(_REPORT_EVERY_S):
                progress(shared.done.value, of)

        threading.Thread(target=report, daemon=True).start()
        try:
            _take_parts(config, shared.taken, shared.done, is_over)
        finally:
            finished.set()


@dataclass(frozen=True)
class _Shared:
    """Numbers of parts taken and done, shared with the helping processes."""

    taken: "Synchronized[int]"
    done: "Synchronized[int]"
    helpers: tuple[SpawnProcess, ...]


# A process that ends while it starts another would leave that one without its arguments.
_starting = threading.Lock()
atexit.register(_starting.acquire)


@contextmanager
def _helpers(config: Config, number: int, niceness: int) -> Iterator[_Shared]:
    """Run processes that take parts; wait for their ends."""
    context = get_context("spawn")
    taken, done = context.Value("i", 0), context.Value("i", 0)
    given = config, taken, done, gc.get_threshold(), are_shortcuts_asked_for(), niceness
    helpers = [context.Process(target=_help, args=given, daemon=True) for _ in range(number)]
    with _starting:
        for helper in helpers:
            helper.start()
    yield _Shared(taken, done, tuple(helpers))
    for helper in helpers:
        helper.join()


def _help(
    config: Config,
    taken: "Synchronized[int]",
    done: "Synchronized[int]",
    collecting: tuple[int, int, int],
    shortcuts: bool,  # noqa: FBT001 - arguments of a process are positional
    niceness: int,
) -> None:
    """Compile parts in another process, with the parent's GC thresholds; ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(niceness)
    gc.set_threshold(*collecting)
    if shortcuts:
        take_shortcuts()
    _take_parts(config, taken, done, lambda: False)
    os._exit(0)  # skips the interpreter's shutdown: the parent waits, and it takes 0.5 s


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None  # noqa: S101 - this runs in a child process
    wait([parent.sentinel])
    os._exit(1)


def _take_parts(
    config: Config,
    taken: "Synchronized[int]",
    done: "Synchronized[int]",
    is_over: Callable[[], bool],
) -> None:
    parts = _parts(config)
    while True:
        with taken.get_lock():
            if is_over():
                taken.value = len(parts)  # stops the other process, too
            mine, taken.value = taken.value, taken.value + 1
        if mine >= len(parts):
            return
        parts[mine]()
        with done.get_lock():
            done.value += 1


def _parts(config: Config) -> list[Callable[[], None]]:
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
    grid = spool_fit.Grid(
        few.T, few.U, few.p1, few.Q, 1e-2, 40, spool_fit.Hold.CONSTANT, (0.0, 5.0, 1.0)
    )
    point = spool_fit.Point(10.0, 0.7, spool_fit.NO_SLEW, 0.0, 0.01, 1.0)
    spool_fit.residual(grid, point)
    spool_fit.response(point, 1.0, 0.01)


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
    compile_alignment(config)  # by itself: at first the timing holds changes back
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
