"""The StatusCode of each result (Part 4, 7.39; Part 8, 6). Pure.

=====================================  ==========================================================
no result yet                          BadWaitingForInitialData
parameters not determined              UncertainInitialValue
inputs without variety, parameters held UncertainSubNormal
the newest sample is unusable          BadSensorFailure
no samples arrive                      BadNoCommunication
RequiredU at the end of the range      UncertainEngineeringUnitsExceeded
RequiredU where nothing was measured   UncertainSubNormal
U or Δp outside the estimator's range  UncertainEngineeringUnitsExceeded
nothing demanded                       BadNoData
the map falls with U                   BadInvalidState
=====================================  ==========================================================

Status, SampleCount and similar values describe the service, not the valve. They stay readable as
UncertainLastUsableValue while the other values are Bad, or Uncertain because of their age.
"""

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Times
from valvemap.pipeline.results import EstimatorResults, InverseResults, SignalResults
from valvemap.vocabulary.statuses import InverseStatus, Quality, Status

_Codes = ua.StatusCodes
_BAD = 0x8000_0000

StatusCodes = NDArray[np.uint32]


def estimator_codes(results: EstimatorResults) -> StatusCodes:
    """Return the StatusCodes (M,) of an estimator's numeric results."""
    return _of_estimators(_ESTIMATOR, results)


def estimator_own_words(results: EstimatorResults) -> StatusCodes:
    """Return the StatusCodes (M,) of Status, SampleCount and similar values.

    They are never Bad: these values do not depend on the sensors.
    """
    words = _of_estimators(_ESTIMATOR_ITSELF, results)
    if results.old is None:
        return words
    return np.where(results.old, worse(words, _Codes.UncertainLastUsableValue), words)


def inverse_codes(results: InverseResults) -> StatusCodes:
    """Return the StatusCodes (M,) of the inverse maps."""
    return _of_inverses(_INVERSE, results)


def inverse_own_words(results: InverseResults) -> StatusCodes:
    """Return the StatusCodes (M,) of values that do not depend on the sensors; never Bad."""
    return _of_inverses(_INVERSE_ITSELF, results)


def answer_codes(status: Codes) -> StatusCodes:
    """Return the StatusCodes (M,) of answers to demands, each an `InverseStatus`."""
    return np.asarray(_ANSWERS[status])


def signal_codes(signals: SignalResults) -> StatusCodes:
    """Return the StatusCodes (M,) of the newest samples."""
    return np.asarray(_SIGNAL[_waiting(signals.t), signals.quality])


def worse(codes: StatusCodes, others: StatusCodes | int) -> StatusCodes:
    """Return elementwise the StatusCode of worse severity; the first if they are equal."""
    second = np.asarray(others, np.uint32)
    return np.where(codes >> 30 >= second >> 30, codes, second).astype(np.uint32)


def _of_estimators(table: StatusCodes, results: EstimatorResults) -> StatusCodes:
    return np.asarray(table[_waiting(results.t), results.quality, results.status])


def _of_inverses(table: StatusCodes, results: InverseResults) -> StatusCodes:
    return np.asarray(table[_waiting(results.t), results.quality])


def _waiting(t: Times) -> NDArray[np.uint8]:
    return (t == 0).view(np.uint8)


def _own_words(codes: StatusCodes) -> StatusCodes:
    words = np.where(codes >= _BAD, _Codes.UncertainLastUsableValue, _Codes.Good)
    waiting = codes == _Codes.BadWaitingForInitialData
    return np.where(waiting, _Codes.UncertainInitialValue, words).astype(np.uint32)


def _of_estimator(t: int, quality: Quality, status: Status) -> int:
    if t == 0:
        return int(_Codes.BadWaitingForInitialData)
    if quality == Quality.GOOD:
        return int(_Codes.Good)
    if quality == Quality.UNCERTAIN:
        return int(_UNCERTAIN_BECAUSE.get(status, _Codes.UncertainLastUsableValue))
    return int(_BAD_BECAUSE.get(status, _Codes.BadNoCommunication))


_UNCERTAIN_BECAUSE: dict[Status, int] = {
    Status.WARMING_UP: _Codes.UncertainInitialValue,
    Status.UNEXCITED: _Codes.UncertainSubNormal,
    Status.EXTRAPOLATING: _Codes.UncertainEngineeringUnitsExceeded,
    Status.UNRELIABLE: _Codes.UncertainSubNormal,
}
_BAD_BECAUSE: dict[Status, int] = {
    Status.REJECTED: _Codes.BadSensorFailure,
    Status.FAILED: _Codes.BadInternalError,
}
_OF_INVERSE: dict[Quality, int] = {
    Quality.GOOD: _Codes.Good,
    Quality.UNCERTAIN: _Codes.UncertainSubNormal,
    Quality.BAD: _Codes.BadNoCommunication,
}
_OF_ANSWER: dict[InverseStatus, int] = {
    InverseStatus.OK: _Codes.Good,
    InverseStatus.ABOVE_REACH: _Codes.UncertainEngineeringUnitsExceeded,
    InverseStatus.BELOW_REACH: _Codes.UncertainEngineeringUnitsExceeded,
    InverseStatus.NOT_MONOTONE: _Codes.BadInvalidState,
    InverseStatus.UNIDENTIFIED: _Codes.BadWaitingForInitialData,
    InverseStatus.NOT_FINITE: _Codes.BadNoData,
    InverseStatus.OUTSIDE: _Codes.UncertainEngineeringUnitsExceeded,
    InverseStatus.EXTRAPOLATING: _Codes.UncertainSubNormal,
    InverseStatus.UNCERTAIN: _Codes.UncertainSubNormal,
}

# By "no result yet" (0 or 1), quality, status.
_ESTIMATOR = np.array(
    [[[_of_estimator(t, q, s) for s in Status] for q in Quality] for t in (1, 0)], np.uint32
)
_INVERSE = np.array(
    [[_OF_INVERSE[q] for q in Quality], [_Codes.BadWaitingForInitialData for _ in Quality]],
    np.uint32,
)
_OF_SIGNAL: dict[Quality, int] = {
    Quality.GOOD: _Codes.Good,
    Quality.UNCERTAIN: _Codes.Uncertain,
    Quality.BAD: _Codes.Bad,
}
_SIGNAL = np.array(
    [[_OF_SIGNAL[q] for q in Quality], [_Codes.BadWaitingForInitialData for _ in Quality]],
    np.uint32,
)
_ESTIMATOR_ITSELF, _INVERSE_ITSELF = _own_words(_ESTIMATOR), _own_words(_INVERSE)
_ANSWERS = np.array([_OF_ANSWER[status] for status in InverseStatus], np.uint32)
