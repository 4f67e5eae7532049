"""Results → values with StatusCodes that mean something (Part 4, 7.39; Part 8, 6). Pure.

=====================================  ==========================================================
nothing known yet                      BadWaitingForInitialData
parameters not determined              UncertainInitialValue
inputs without news, parameters held   UncertainSubNormal
the newest sample is unusable          BadSensorFailure
no samples any more                    BadNoCommunication
RequiredU at the end of the range      UncertainEngineeringUnitsExceeded
nothing demanded                       BadNoData
the map falls with U                   BadInvalidState
=====================================  ==========================================================

Status, SampleCount and the like are the service's own words: they stay readable, as
UncertainLastUsableValue, while the rest is Bad.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from asyncua import ua

from service.identification.inversion import InverseStatus
from service.identification.samples import Quality, Status
from service.opcua.information_model import INVERSE
from service.streaming.ports import EstimatorResult, InverseResult, ValveResult

_Codes = ua.StatusCodes
_BAD = 0x8000_0000


@dataclass(frozen=True)
class Shown:
    """A variable's new value: identifier, value, StatusCode, source time (UTC ns)."""

    id: str
    value: Any
    code: int
    t: int


def values_of(result: ValveResult, now: int) -> Iterator[Shown]:
    """All that is shown of one valve, but for its map and counters.

    ``now`` (UTC ns) stamps what no sample is behind yet.
    """
    for name, estimator in result.estimators.items():
        yield from _estimator_values(f"{result.valve}.{name}", estimator, now)
    yield from _inverse_values(f"{result.valve}.{INVERSE}", result.inverse, now)


def survey_values(valve: str, name: str, result: EstimatorResult, now: int) -> Iterator[Shown]:
    """How well an estimator knows its map; nothing before the first survey."""
    survey = result.survey
    if survey is None:
        return
    code, t = own_words(estimator_code(result)), result.t or now
    for variable, value in (
        ("Coverage", survey.std),
        ("CoverageAge", survey.age_s),
        ("CoverageShare", survey.share),
        ("Conditioning", survey.condition),
        ("SuggestedU", survey.suggested_U),
        ("SuggestedDp", survey.suggested_dp),
    ):
        yield Shown(f"{valve}.{name}.{variable}", value, code, t)


def discovery_values(valve: str, name: str, result: EstimatorResult, now: int) -> Iterator[Shown]:
    """What an estimator found out by itself: changes of the valve, the structure of its map."""
    prefix, t = f"{valve}.{name}", result.t or now
    own = own_words(estimator_code(result))
    found, code = result.change, own if result.change else int(_Codes.BadNoData)
    yield Shown(f"{prefix}.ChangeCount", found.count if found else 0, own, t)
    moment = datetime.fromtimestamp(found.t / 1e9, UTC) if found else None
    yield Shown(f"{prefix}.ChangeTime", moment, code, t)
    yield Shown(f"{prefix}.ChangeSize", found.size if found else 0.0, code, t)
    yield Shown(f"{prefix}.Structure", result.structure or "", own, t)


def map_value(result: ValveResult, now: int) -> Shown:
    """The inverse map of one valve."""
    inverse = result.inverse
    code = _inverse_code(inverse)
    if not np.isfinite(inverse.map_U).any():
        code = worse(code, _Codes.BadWaitingForInitialData)
    id_ = f"{result.valve}.{INVERSE}.Map"
    return Shown(id_, inverse.map_U, code, inverse.t or now)


def estimator_code(result: EstimatorResult) -> int:
    """StatusCode of what an estimator knows."""
    if result.t == 0:
        return int(_Codes.BadWaitingForInitialData)
    if result.quality == Quality.GOOD:
        return int(_Codes.Good)
    if result.quality == Quality.UNCERTAIN:
        return int(_UNCERTAIN_BECAUSE.get(result.status, _Codes.UncertainLastUsableValue))
    rejected = result.status == Status.REJECTED
    return int(_Codes.BadSensorFailure if rejected else _Codes.BadNoCommunication)


_UNCERTAIN_BECAUSE: dict[Status, int] = {
    Status.WARMING_UP: _Codes.UncertainInitialValue,
    Status.UNEXCITED: _Codes.UncertainSubNormal,
}


def _estimator_values(prefix: str, result: EstimatorResult, now: int) -> Iterator[Shown]:
    code, t = estimator_code(result), result.t or now
    own = own_words(code)
    for name, value, number_code in (
        ("ParameterVector", result.theta, code),
        ("ParameterStd", result.std, code),
        ("ParameterNames", list(result.parameter_names), int(_Codes.Good)),
        ("PredictedFlow", result.predicted, _of_number(result.predicted, code)),
        ("Residual", result.residual, _of_number(result.residual, code)),
        ("ResidualRmse", result.residual_rmse, _of_number(result.residual_rmse, code)),
        ("NoiseStd", result.noise_std, _of_number(result.noise_std, code)),
        ("SampleCount", result.sample_count, own),
        ("Status", int(result.status), own),
    ):
        yield Shown(f"{prefix}.{name}", value, number_code, t)


def _inverse_values(prefix: str, result: InverseResult, now: int) -> Iterator[Shown]:
    t = result.t or now
    code = worse(_inverse_code(result), _ANSWERS[InverseStatus(result.status)])
    yield Shown(f"{prefix}.RequiredU", result.required_U, code, t)
    yield Shown(
        f"{prefix}.RequiredUStatus", int(result.status), own_words(_inverse_code(result)), t
    )


def _inverse_code(result: InverseResult) -> int:
    if result.t == 0:
        return int(_Codes.BadWaitingForInitialData)
    return {
        Quality.GOOD: int(_Codes.Good),
        Quality.UNCERTAIN: int(_Codes.UncertainSubNormal),
        Quality.BAD: int(_Codes.BadNoCommunication),
    }[result.quality]


_ANSWERS: dict[InverseStatus, int] = {
    InverseStatus.OK: _Codes.Good,
    InverseStatus.ABOVE_REACH: _Codes.UncertainEngineeringUnitsExceeded,
    InverseStatus.BELOW_REACH: _Codes.UncertainEngineeringUnitsExceeded,
    InverseStatus.NOT_MONOTONE: _Codes.BadInvalidState,
    InverseStatus.UNIDENTIFIED: _Codes.BadWaitingForInitialData,
    InverseStatus.NOT_FINITE: _Codes.BadNoData,
}


def _of_number(value: float, code: int) -> int:
    """A number that is none is not Good."""
    return code if np.isfinite(value) else worse(code, _Codes.UncertainInitialValue)


def own_words(code: int) -> int:
    """StatusCode of what the service itself knows for certain, whatever its sensors do."""
    if code == _Codes.BadWaitingForInitialData:
        return int(_Codes.UncertainInitialValue)
    return int(_Codes.UncertainLastUsableValue) if code & _BAD else int(_Codes.Good)


def worse(code: int, other: int) -> int:
    """The StatusCode of the worse severity; the first, if they are equal."""
    return code if code >> 30 >= other >> 30 else int(other)
