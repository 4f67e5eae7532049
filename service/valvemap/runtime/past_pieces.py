"""Rows of the history: signals, results and axes as pieces of one series each."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Floats, Samples, Times
from valvemap.pipeline.axis_ports import AxisResults
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.results import Results
from valvemap.pipeline.store_ports import Piece
from valvemap.vocabulary.history_columns import REQUIRED_U, REQUIRED_U_STATUS, STATUS
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES
from valvemap.vocabulary.signals import PUBLISHED
from valvemap.vocabulary.statuses import Quality

SIGNALS, INVERSE = "Signals", "Inverse"
_CODES = np.zeros(max(Quality) + 1, np.uint32)
_CODES[Quality.UNCERTAIN], _CODES[Quality.BAD] = 0x4000_0000, 0x8000_0000


def signals_of(valve: str) -> str:
    """Return the series name of a valve's signals."""
    return f"{valve}.{SIGNALS}"


def results_of(valve: str, part: str) -> str:
    """Return the series name of results of an estimator or inverse map, or of an axis' status."""
    return f"{valve}.{part}"


class PartResults(NamedTuple):
    """Buffered results of one part (an estimator, the inverse map, signals) for (M,) valves."""

    part: str
    valves: Times
    quality: Codes
    t: Times
    columns: Mapping[str, Floats]


def pieces_of(axis: str, results: AxisResults, *, with_map: bool) -> list[Piece]:
    """Return the rows of an axis: status, answer to a demand, and ``with_map`` its quantities.

    While it is stale, it has no sample: the time is that of the last sample plus 1 ns.
    """
    quality = Quality.UNCERTAIN if results.is_stale else Quality.GOOD
    t, good = np.array([results.t]), _CODES[[Quality.GOOD]]
    status = {STATUS: np.array([float(results.status)])}
    pieces = [Piece(results_of(axis, STATUS), t + results.is_stale, good, status)]
    if with_map:
        columns = {name: np.array([value]) for name, value in results.numbers.items()}
        pieces.append(Piece(axis, t, _CODES[[quality]], columns))
    if np.isfinite(results.required.U):
        answer = {
            REQUIRED_U: np.array([results.required.U]),
            REQUIRED_U_STATUS: np.array([float(results.required.status)]),
        }
        pieces.append(Piece(results_of(axis, INVERSE), t, good, answer))
    return pieces


def joined(pieces: Sequence[Piece]) -> Iterator[Piece]:
    """Yield one piece for each series and its columns, which another configuration may change."""
    alike: dict[tuple[str, ...], list[Piece]] = {}
    for piece in pieces:
        alike.setdefault((piece.series, *piece.columns), []).append(piece)
    for (series, *names), own in alike.items():
        columns = {name: np.concatenate([one.columns[name] for one in own]) for name in names}
        codes = np.concatenate([one.codes for one in own])
        yield Piece(series, np.concatenate([one.t for one in own]), codes, columns)


def rows_of_samples(
    names: Sequence[str], batches: Sequence[ByValve], failed: dict[str, Exception]
) -> Iterator[Piece]:
    """Yield one piece for each valve; valves whose piece raises are added to ``failed``."""
    by_valve: dict[int, list[ByValve]] = {}
    for batch in batches:
        for valve in batch:
            by_valve.setdefault(valve, []).append(batch)
    for valve, own in by_valve.items():
        try:
            piece = _signals(names[valve], [batch[valve] for batch in own])
        except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
            failed[names[valve]] = error
        else:
            yield piece


def _signals(valve: str, samples: Sequence[Samples]) -> Piece:
    columns = {
        name: np.concatenate([getattr(part, name) for part in samples]) for name in PUBLISHED
    }
    t = np.concatenate([part.t for part in samples])
    quality = np.concatenate([part.quality for part in samples])
    return Piece(signals_of(valve), t, _CODES[quality], columns)


def parts_of(results: Results) -> Iterator[PartResults]:
    """Yield the rows of each estimator, of the inverse map, and of signals that are Bad."""
    valves, inverse, signals = results.valves, results.inverse, results.signals
    for name, found in results.estimators.items():
        columns = {q.name: _numbers(getattr(found, q.field)) for q in HISTORY_QUANTITIES}
        yield PartResults(name, valves, found.quality, found.t, columns)
    answer = {REQUIRED_U: inverse.required_U, REQUIRED_U_STATUS: _numbers(inverse.status)}
    yield PartResults(INVERSE, valves, inverse.quality, inverse.t, answer)
    if signals is not None:
        lost = signals.quality == Quality.BAD
        columns = dict(zip(PUBLISHED, signals.values[lost].T, strict=True))
        yield PartResults(SIGNALS, valves[lost], signals.quality[lost], signals.t[lost], columns)


def rows_of_results(
    names: Sequence[str], results: Sequence[PartResults], failed: dict[str, Exception]
) -> Iterator[Piece]:
    """Yield one piece for each part of each valve.

    Bad results have no sample: their time is that of the last sample plus 1 ns.
    """
    by_part: dict[str, list[PartResults]] = {}
    for one in results:
        by_part.setdefault(one.part, []).append(one)
    for part, rows in by_part.items():
        yield from _by_valve(names, part, rows, failed)


def _by_valve(
    names: Sequence[str], part: str, rows: Sequence[PartResults], failed: dict[str, Exception]
) -> Iterator[Piece]:
    valves = np.concatenate([row.valves for row in rows])
    quality = np.concatenate([row.quality for row in rows])
    t = np.concatenate([row.t for row in rows])
    columns = {
        name: np.concatenate([row.columns[name] for row in rows]) for name in rows[0].columns
    }
    t = np.where(quality == Quality.BAD, t + 1, t)
    order = np.argsort(valves, kind="stable")
    order = order[t[order] > 1]  # no sample yet
    if not len(order):
        return
    ordered = valves[order]
    starts = ((ordered[1:] != ordered[:-1]).nonzero()[0] + 1).tolist()
    for first, last in pairwise([0, *starts, len(order)]):
        own, name = order[first:last], names[int(valves[order[first]])]
        try:
            of_valve = {column: values[own] for column, values in columns.items()}
            piece = Piece(results_of(name, part), t[own], _codes(quality[own]), of_valve)
        except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
            failed[name] = error
        else:
            yield piece


def _numbers(values: NDArray[Any]) -> Floats:
    return np.asarray(values, np.float64)


def _codes(quality: Codes) -> NDArray[np.uint32]:
    return np.asarray(_CODES[quality])
