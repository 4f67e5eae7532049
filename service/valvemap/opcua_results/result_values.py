"""Maps results to values of variables with StatusCodes. Pure."""

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Self

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.model.change import Change
from valvemap.model.samples import Floats, Times
from valvemap.model.survey import Survey
from valvemap.opcua_results.information_model import (
    ALARMS,
    ARMED,
    BASELINE,
    DIAGNOSTICS,
    FEED_FORWARD_STATUS,
    INVERSE,
    LAG_Q,
    LAG_U,
    LEAKAGE,
    LEAKAGE_STD,
    PARAMETERS,
    SERVICE,
    SIGNALS,
)
from valvemap.opcua_results.result_codes import (
    StatusCodes,
    answer_codes,
    estimator_codes,
    estimator_own_words,
    inverse_codes,
    inverse_own_words,
    signal_codes,
    worse,
)
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.result_ports import Health
from valvemap.pipeline.results import (
    EstimatorResults,
    InverseResults,
    LineResults,
    Results,
    SignalResults,
    Version,
)
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, Undetermined

_Codes = ua.StatusCodes


@dataclass(frozen=True)
class Column:
    """One variable of M valves: its name within the valve, values, StatusCodes, source times.

    For k variables that are published side by side, values and codes are (M, k).
    """

    name: str
    values: NDArray[Any]
    codes: StatusCodes
    t: Times

    def __getitem__(self, valves: NDArray[np.bool_]) -> Self:
        return type(self)(self.name, self.values[valves], self.codes[valves], self.t[valves])


@dataclass(frozen=True)
class Shown:
    """One variable's new value: its name within the valve, value, StatusCode, source time."""

    name: str
    value: Any
    code: int
    t: int


def columns_of(results: Results, now: int, by_name: Collection[str] = ()) -> Iterator[Column]:
    """Yield all numeric variables of M valves, except maps and counters.

    ``now`` (UTC ns) is the source time of values without a sample. ``by_name`` are the estimators
    whose parameters are also published as separate variables.
    """
    for name, estimator in results.estimators.items():
        yield from _estimator_columns(name, estimator, now, by_name=name in by_name)
    yield from _inverse_columns(results.inverse, now)
    if results.lines is not None:
        yield from _line_columns(results.lines, results.inverse, now)
    if results.signals is not None:
        yield _signal_column(results.signals, now)


def survey_values(name: str, survey: Survey | None, code: int, t: int) -> Iterator[Shown]:
    """Yield the variables of an estimator's survey; nothing before the first survey."""
    if survey is None:
        return
    for variable, value in (
        ("Coverage", survey.std),
        ("CoverageAge", survey.age_s),
        ("CoverageShare", survey.share),
        ("Conditioning", survey.condition),
        ("SuggestedU", survey.suggested_U),
        ("SuggestedDp", survey.suggested_dp),
    ):
        yield Shown(f"{name}.{variable}", value, code, t)


def discovery_values(
    name: str, found: Change | None, structure: str | None, own: int, t: int
) -> Iterator[Shown]:
    """Yield the detected changes of a valve and the chosen structure of its map."""
    code = own if found else int(_Codes.BadNoData)
    yield Shown(f"{name}.ChangeCount", found.count if found else 0, own, t)
    moment = datetime.fromtimestamp(found.t / 1e9, UTC) if found else None
    yield Shown(f"{name}.ChangeTime", moment, code, t)
    yield Shown(f"{name}.ChangeSize", found.size if found else 0.0, code, t)
    yield Shown(f"{name}.Structure", structure or "", own, t)


def lag_values(lags: tuple[float, float], own: int, t: int) -> Iterator[Shown]:
    """Yield the lags of U's effect and of the flow meter, s."""
    for name, lag in zip((LAG_U, LAG_Q), lags, strict=True):
        code = own if np.isfinite(lag) else int(_Codes.BadNoData)
        yield Shown(f"{DIAGNOSTICS}.{name}", lag, code, t)


def baseline_values(found: Version | None, now: int) -> Iterator[Shown]:
    """Yield the variables of the baseline; ``now`` (UTC ns) is their source time."""
    code = int(_Codes.Good if found is not None else _Codes.BadNoData)
    moment = None if found is None else datetime.fromtimestamp(found.t / 1e9, UTC)
    version, digest = ("", "") if found is None else (found.version, found.digest)
    yield Shown(f"{BASELINE}.Version", version, int(_Codes.Good), now)
    yield Shown(f"{BASELINE}.Time", moment, code, now)
    yield Shown(f"{BASELINE}.DataHash", digest, code, now)


def alarm_values(alarms: Iterable[AlarmReport], now: int) -> Iterator[Shown]:
    """Yield the variables of alarms; ``now`` (UTC ns) stamps alarms that never changed."""
    good = int(_Codes.Good)
    for alarm in alarms:
        prefix, t = f"{ALARMS}.{alarm.name}", alarm.at or now
        since = datetime.fromtimestamp(alarm.since / 1e9, UTC) if alarm.since else None
        yield Shown(f"{prefix}.Active", alarm.active, good, t)
        yield Shown(f"{prefix}.Severity", alarm.severity, good, t)
        yield Shown(f"{prefix}.Since", since, good if since else int(_Codes.BadNoData), t)
        yield Shown(f"{prefix}.Text", alarm.text, good, t)
        yield Shown(f"{prefix}.Acked", alarm.acked, good, t)
        yield Shown(f"{prefix}.Confirmed", alarm.confirmed, good, t)


def feed_forward_values(*, armed: bool, status: int, t: int) -> Iterator[Shown]:
    """Yield Armed and FeedForwardStatus; both are Good regardless of the sensors."""
    yield Shown(f"{INVERSE}.{ARMED}", armed, int(_Codes.Good), t)
    yield Shown(f"{INVERSE}.{FEED_FORWARD_STATUS}", status, int(_Codes.Good), t)


def service_values(health: Health) -> Iterator[tuple[str, Any, int]]:
    """Yield identifier, value and StatusCode of each variable of the service itself."""
    never = math.isnan(health.checkpoint_age_s)
    age_code = _Codes.BadWaitingForInitialData if never else _Codes.Good
    yield f"{SERVICE}.Checkpoint.Age", health.checkpoint_age_s, int(age_code)
    for name, count in (
        ("Checkpoint.Failures", health.checkpoint_failures),
        ("Checkpoint.Refused", health.checkpoints_refused),
        ("Checkpoint.Size", health.checkpoint_bytes),
        ("Source.Notifications", health.source.notifications),
        ("Source.Overflows", health.source.overflows),
        ("Source.MissingMessages", health.source.missing_messages),
        ("Source.Undecodable", health.source.undecodable),
        ("Source.FromHistory", health.source.from_history),
        ("History.Lost", health.history.lost),
        ("History.Failures", health.history.failures),
        ("History.Size", health.history.bytes),
    ):
        yield f"{SERVICE}.{name}", count, int(_Codes.Good)
    yield f"{SERVICE}.Source.States", list(health.source_states), int(_Codes.Good)
    yield f"{SERVICE}.Start.Text", health.start.text, int(_Codes.Good)
    yield f"{SERVICE}.Start.Compiled", health.start.compiled_percent, int(_Codes.Good)


def map_value(table: Floats, code: int, t: int) -> Shown:
    """Return the value of the inverse map; ``code`` is one of `inverse_codes`."""
    if not np.isfinite(table).any():
        code = int(worse(np.array([code]), _Codes.BadWaitingForInitialData)[0])
    return Shown(f"{INVERSE}.Map", table, code, t)


def _estimator_columns(
    name: str, results: EstimatorResults, now: int, *, by_name: bool
) -> Iterator[Column]:
    codes, own = estimator_codes(results), estimator_own_words(results)
    doubtful = worse(codes, _Codes.UncertainInitialValue)
    t = np.where(results.t, results.t, now)
    yield Column(f"{name}.ParameterVector", results.theta, codes, t)
    yield Column(f"{name}.ParameterStd", results.std, codes, t)
    of_nan = {  # StatusCodes where the value is NaN
        Undetermined.UNCERTAIN: doubtful,
        Undetermined.BAD: worse(codes, _Codes.BadNoData),
    }
    for quantity in ESTIMATOR_QUANTITIES:
        values = getattr(results, quantity.field)
        if quantity.undetermined is Undetermined.NEVER:
            stated = own
        else:
            stated = np.where(np.isfinite(values), codes, of_nan[quantity.undetermined])
        yield Column(f"{name}.{quantity.name}", values, stated, t)
    if by_name:
        yield _each(f"{name}.{PARAMETERS}", results.theta, codes, doubtful, t)


def _signal_column(signals: SignalResults, now: int) -> Column:
    codes = signal_codes(signals)
    none = worse(codes, _Codes.BadNoData)
    return _each(SIGNALS, signals.values, codes, none, np.where(signals.t, signals.t, now))


def _each(name: str, values: Floats, codes: StatusCodes, of_none: StatusCodes, t: Times) -> Column:
    """Return variables side by side; values that are not finite get the codes ``of_none``."""
    each = np.where(np.isfinite(values), codes[:, None], of_none[:, None])
    return Column(name, values, each, t)


def _inverse_columns(results: InverseResults, now: int) -> Iterator[Column]:
    codes, t = inverse_codes(results), np.where(results.t, results.t, now)
    answers = worse(codes, answer_codes(results.status))
    yield Column(f"{INVERSE}.RequiredU", results.required_U, answers, t)
    for end, values in (("Lower", results.lower), ("Upper", results.upper)):
        yield Column(f"{INVERSE}.RequiredU{end}", values, answers, t)
    own = inverse_own_words(results)
    yield Column(f"{INVERSE}.RequiredUStatus", results.status, own, t)


def _line_columns(lines: LineResults, inverse: InverseResults, now: int) -> Iterator[Column]:
    codes, t = inverse_codes(inverse), np.where(inverse.t, inverse.t, now)
    for name, values in ((LEAKAGE, lines.leakage), (LEAKAGE_STD, lines.leakage_std)):
        known = np.where(np.isfinite(values), codes, worse(codes, _Codes.UncertainInitialValue))
        yield Column(name, values, known, t)
    yield Column(f"{INVERSE}.Edge", lines.edge, inverse_own_words(inverse), t)
