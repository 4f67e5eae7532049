"""One array per valve with all its numbers, so that a client reads them consistently. Pure.

``s=<Valve>.Frame`` holds Doubles, ``s=<Valve>.FrameNames`` their names. Its SourceTimestamp is that
of the newest sample used. Unknown values are NaN. The first column, ``Sequence``, increments by one
with each frame: a larger step means lost frames.
"""

from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Times
from valvemap.opcua_results.information_model import (
    FRAME,
    FRAME_NAMES,
    INVERSE,
    SIGNALS,
    VariableNode,
)
from valvemap.opcua_results.result_codes import estimator_own_words, worse
from valvemap.opcua_results.result_values import Column
from valvemap.pipeline.results import Results, ValveDescription
from valvemap.vocabulary.quantities import FRAME_QUANTITIES
from valvemap.vocabulary.signals import PUBLISHED
from valvemap.vocabulary.statuses import Quality


def frame_names(valve: ValveDescription) -> tuple[str, ...]:
    """Return the names of the frame's columns.

    >>> from valvemap.pipeline.results import EstimatorDescription
    >>> rls = EstimatorDescription("RLS", "", ("a",), has_forgetting_factor=True)
    >>> frame_names(ValveDescription("V1", (rls,)))[:3]
    ('Sequence', 'RLS.PredictedFlow', 'RLS.Residual')
    """
    columns = ["Sequence"]
    for estimator in valve.estimators:
        columns += [f"{estimator.name}.{quantity.name}" for quantity in FRAME_QUANTITIES]
        columns += [
            f"{estimator.name}.ParameterVector.{name}" for name in estimator.parameter_names
        ]
    columns += [f"{INVERSE}.RequiredU", f"{INVERSE}.RequiredUStatus"]
    return (*columns, *(f"{SIGNALS}.{name}" for name in PUBLISHED))


def frame_variables(valve: ValveDescription) -> tuple[VariableNode, VariableNode]:
    """Return the variables Frame and FrameNames."""
    count = len(frame_names(valve))
    return (
        VariableNode(
            f"{valve.name}.{FRAME}",
            "All values of the newest result in one array; FrameNames names its columns.",
            dimensions=(count,),
        ),
        VariableNode(
            f"{valve.name}.{FRAME_NAMES}",
            "Names of the columns of Frame.",
            ua.VariantType.String,
            dimensions=(count,),
        ),
    )


def frames(valve: ValveDescription, results: Results, sequence: Times, now: int) -> Column:
    """Return the frames of M valves that have the layout of ``valve``.

    ``sequence`` (M,) holds their sequence numbers.
    """
    M = len(results.valves)
    codes, t = np.full(M, ua.StatusCodes.Good, np.uint32), np.zeros(M, np.int64)
    columns: list[NDArray[Any]] = [sequence]
    for described in valve.estimators:
        found = results.estimators.get(described.name)
        n = len(described.parameter_names)
        if found is None:
            columns.append(np.full((M, len(FRAME_QUANTITIES) + n), np.nan))
            continue
        codes = worse(codes, estimator_own_words(found))
        t = np.maximum(t, found.t)
        columns += [getattr(found, quantity.field) for quantity in FRAME_QUANTITIES]
        columns.append(found.theta)
    columns += [results.inverse.required_U, results.inverse.status, _signals(results)]
    values = np.column_stack([np.asarray(column, np.float64) for column in columns])
    return Column(FRAME, values, codes, np.where(t, t, now))


def _signals(results: Results) -> Floats:
    """Return the newest sample of M valves, (M, 6); NaN where the sensors are lost."""
    signals = results.signals
    if signals is None:
        return np.full((len(results.valves), len(PUBLISHED)), np.nan)
    lost = (signals.quality == Quality.BAD) | (signals.t == 0)
    return np.where(lost[:, None], np.nan, signals.values)
