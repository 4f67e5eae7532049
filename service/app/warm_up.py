"""Compiling every kernel ahead, so that no sample waits for a compiler."""

import os
import signal
from multiprocessing import get_context

import numpy as np

from service.app.build import build_identification, build_plans
from service.config.models import Config
from service.identification import lag_search, map_search
from service.identification.auto import Auto
from service.identification.kernels import cells, grid, lag
from service.identification.map_shapes import Shape
from service.identification.samples import Samples
from service.opcua.decoding import decode_data_changes, was_compiled_before
from service.streaming.data_changes import DataChanges

_NO_CHANGES = bytes(4) + b"\xff" * 4  # a DataChangeNotification: no items, no diagnostics
_ONE_CHANGE = DataChanges(
    item=np.zeros(1, np.int32),
    value=np.zeros(1),
    status=np.zeros(1, np.uint32),
    source_time=np.zeros(1, np.int64),
)


def warm_up(config: Config) -> None:
    """Have every kernel compiled that this configuration needs.

    The first run on a machine compiles for half a minute and caches the result on disk; later runs
    load it. A second process then helps: it begins with the second estimator.
    """
    decode_data_changes(_NO_CHANGES)
    helper = None
    if not was_compiled_before() and (os.cpu_count() or 1) > 1:
        helper = get_context("spawn").Process(target=_help, args=(config,), daemon=True)
        helper.start()
    _compile(config)
    if helper is not None:
        helper.terminate()  # what it is still at is compiled here already
        helper.join()


def _help(config: Config) -> None:
    """Run the estimators alone, the first one last; Ctrl-C is for the service to answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for plan in build_plans(config):
        first, *others = plan.estimators.values()
        for estimator in (*others, first):
            state, _ = estimator.update(estimator.initial_state(), _samples())
            estimator.predict(state, *(np.full(1, x) for x in (50.0, 100.0, 40.0)))
            estimator.parameters(state)


def _compile(config: Config) -> None:
    """Run every kind of pipeline once on made-up samples; nothing of it is kept."""
    identification = build_identification(config)
    identification.take(_ONE_CHANGE)
    identification.waits()
    for valve in identification.one_of_each_kind():
        plan = identification.plans[valve]
        identification.take_samples(valve, _samples())
        for estimator in plan.estimators:
            identification.predict(plan.name, estimator, 50.0, 100.0, 40.0)
            identification.predict_measurement(plan.name, estimator, 50.0, 100.0, 40.0)
            support, one = identification.lane(plan.name, estimator).support, np.full(1, 50.0)
            support.misfit(one, one, one)  # which kernels a map needs, its samples decide
            support.may_hide(one, one)
        identification.result(valve)
    identification.refresh_maps()
    plans = identification.plans
    if any(isinstance(one, Auto) for plan in plans for one in plan.estimators.values()):
        _compile_what_auto_seldom_needs()


def _compile_what_auto_seldom_needs() -> None:
    """... as only some samples lead to it: a look for lags, a rival from elsewhere, a drift."""
    state = Auto().initial_state()
    scalars, shape = state.scalars, Shape.from_array(state.shapes[0])
    rows = state.recent[:1].astype(np.float64)
    lag_search.look(rows, scalars[cells.LAGS + lag.KNOWN_LAGS :], (None, None))
    map_search.is_better(np.ones((1, len(grid.COLUMNS))), shape, shape, 100.0)
    cells.colour(scalars)


def _samples() -> Samples:
    n = 32
    k = np.arange(n, dtype=np.float64)
    U, dp = (37.0 * k) % 100.0, (1.0 + 61.0 * k) % 200.0
    return Samples.of(
        t=np.arange(n), U=U, p1=np.full(n, 200.0), p2=200.0 - dp, Q=U * np.sqrt(dp) / 10, T=0 * U
    )
