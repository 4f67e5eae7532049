"""One array per valve with all its numbers, so that a machine reads them together. Pure.

``s=<Valve>.Frame`` holds Doubles whose names ``s=<Valve>.FrameNames`` gives; its SourceTimestamp is
that of the newest sample behind it. NaN is what is not known. The first column, ``Sequence``, grows
by one with each frame: a jump is a loss.
"""

import numpy as np
from asyncua import ua

from service.identification.samples import Floats
from service.opcua.information_model import FRAME, FRAME_NAMES, INVERSE, VariableNode
from service.opcua.result_values import Shown, estimator_code, own_words, worse
from service.streaming.ports import EstimatorDescription, ValveDescription, ValveResult

_NUMBERS = ("PredictedFlow", "Residual", "ResidualRmse", "NoiseStd", "SampleCount", "Status")


def frame_names(valve: ValveDescription) -> tuple[str, ...]:
    """Names of the columns.

    >>> rls = EstimatorDescription("RLS", "", ("a",), has_forgetting_factor=True)
    >>> frame_names(ValveDescription("V1", (rls,)))[:3]
    ('Sequence', 'RLS.PredictedFlow', 'RLS.Residual')
    """
    columns = ["Sequence"]
    for estimator in valve.estimators:
        columns += [f"{estimator.name}.{name}" for name in _NUMBERS]
        columns += [
            f"{estimator.name}.ParameterVector.{name}" for name in estimator.parameter_names
        ]
    return (*columns, f"{INVERSE}.RequiredU", f"{INVERSE}.RequiredUStatus")


def frame_variables(valve: ValveDescription) -> tuple[VariableNode, VariableNode]:
    """The frame, and the names of its columns."""
    count = len(frame_names(valve))
    return (
        VariableNode(
            f"{valve.name}.{FRAME}",
            "All numbers of the newest result in one array; FrameNames names its columns.",
            dimensions=(count,),
        ),
        VariableNode(
            f"{valve.name}.{FRAME_NAMES}",
            "Names of the columns of Frame.",
            ua.VariantType.String,
            dimensions=(count,),
        ),
    )


def frame(valve: ValveDescription, result: ValveResult, sequence: int, now: int) -> Shown:
    """The numbers of one result; parameters only of a structure that is the one described."""
    row: list[float] = [sequence]
    code, t = int(ua.StatusCodes.Good), 0
    for described in valve.estimators:
        found = result.estimators.get(described.name)
        if found is None:
            row += [np.nan] * (len(_NUMBERS) + len(described.parameter_names))
            continue
        code, t = worse(code, own_words(estimator_code(found))), max(t, found.t)
        row += [found.predicted, found.residual, found.residual_rmse, found.noise_std]
        row += [found.sample_count, int(found.status)]
        row += _theta(described, found.parameter_names, found.theta)
    row += [result.inverse.required_U, int(result.inverse.status)]
    return Shown(f"{valve.name}.{FRAME}", np.array(row, float), code, t or now)


def _theta(described: EstimatorDescription, names: tuple[str, ...], theta: Floats) -> list[float]:
    if names != described.parameter_names:
        return [np.nan] * len(described.parameter_names)
    return np.asarray(theta).tolist()
