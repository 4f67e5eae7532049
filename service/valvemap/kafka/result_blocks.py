"""Results of a group as blocks: one row a valve; `docs/fleet.md` defines the schema.

Tables of the inverse map and surveys are large and computed in turns: a block holds the new ones.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from valvemap.errors import BlockError
from valvemap.kafka.blocks import (
    TIME,
    Head,
    batch_column,
    names_of,
    numpy_of,
    read,
    times,
    write,
)
from valvemap.kafka.json_messages import whole
from valvemap.model.change import Change
from valvemap.model.samples import Floats
from valvemap.model.survey import Survey
from valvemap.pipeline.recommendation import NOT_YET, Recommendation
from valvemap.pipeline.results import (
    AlarmReport,
    AlarmResults,
    EstimatorResults,
    InverseResults,
    Results,
    SignalResults,
    Version,
)
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, Kind
from valvemap.vocabulary.signals import PUBLISHED

_RESULTS: Final = "results"
_FLOATS: Final = pa.list_(pa.float64())
_NAMES: Final = pa.list_(pa.string())
_SURVEY: Final = pa.struct(
    [(name, _FLOATS) for name in ("U", "dp", "std", "age_s")]
    + [(name, pa.float64()) for name in ("share", "condition", "suggested_U", "suggested_dp")]
)
_CHANGE: Final = pa.struct(
    [("count", pa.int64()), ("sample", pa.int64()), ("t", pa.int64()), ("size", pa.float64())]
)
_BASELINE: Final = pa.struct([("version", pa.string()), ("t", pa.int64()), ("digest", pa.string())])
_ALARMS: Final = pa.list_(
    pa.struct(
        [("name", pa.string()), ("active", pa.bool_()), ("acked", pa.bool_())]
        + [(name, pa.int64()) for name in ("severity", "since", "at", "count")]
        + [("text", pa.string()), ("confirmed", pa.bool_()), ("limit", pa.float64())]
        + [("comment", pa.string()), ("commented_by", pa.string())]
        + [("commented", pa.int64()), ("ended", pa.int64())]
    )
)
_NO_TABLE: Final = np.empty((0, 0))
_MOST_OF_TABLE: Final = 1_000  # rows or columns of the inverse map's table: 21 by default


@dataclass(frozen=True)
class ResultsBlock:
    """Results of valves of one group with equal configuration, after a block of samples.

    Attributes
    ----------
    group, number
        Group, and number of the last block of samples processed.
    valves
        Names; ``results.valves`` are numbers in this list.
    results
        ``inverse.map_U`` is (0, 0) and ``survey`` None unless they are new.
    """

    group: str
    number: int
    valves: tuple[str, ...]
    results: Results


class KnownVersion(NamedTuple):
    """Identification of an approved map in results."""

    version: str
    t: int
    digest: str


def write_results(block: ResultsBlock) -> bytes:
    """Encode results."""
    found = block.results
    M, signals = len(found.valves), found.signals
    columns = {"valve": pa.array([block.valves[valve] for valve in found.valves], pa.string())}
    if signals is not None:
        columns["signals.t"] = times(signals.t)
        columns["signals.quality"] = pa.array(signals.quality)
        for k, name in enumerate(PUBLISHED):
            columns[f"signals.{name}"] = pa.array(np.ascontiguousarray(signals.values[:, k]))
    for estimator, own in found.estimators.items():
        for name, form in _ESTIMATOR.items():
            columns[f"{estimator}.{name}"] = form.column(getattr(own, name))
    for name, form in _INVERSE.items():
        columns[f"inverse.{name}"] = form.column(getattr(found.inverse, name))
    columns["counters"] = _rows(np.asarray(found.counters, np.int64).reshape(M, -1))
    columns["waiting"] = _lists(found.waiting or [()] * M)
    columns["timing"] = _lists(found.timing or [()] * M)
    columns["findings"] = pa.array(
        [[_finding_row(one) for one in own] for own in found.findings or [()] * M], _FINDINGS
    )
    columns["recommended"] = _lists(found.recommended or [NOT_YET] * M)
    columns["baseline"] = _structs(found.baselines or [None] * M, _BASELINE)
    if found.alarms is not None:
        columns["alarms.version"] = pa.array(np.asarray(found.alarms.version, np.int64))
        columns["alarms.reports"] = _reports(found.alarms)
    shapes = {table.shape for table in found.inverse.map_U if table.size}
    more = {
        "estimators": list(found.estimators),
        "counters": list(found.counter_names),
        "map_shape": list(shapes.pop()) if shapes else [0, 0],
    }
    return write(Head(_RESULTS, block.group, block.number, more), columns)


def read_results(message: bytes) -> ResultsBlock:
    """Decode results.

    Raises
    ------
    BlockError
        if the message is not a block of results, is damaged, or has another version.
    """
    head, batch = read(message, _RESULTS)
    try:
        return _results(head, batch)
    except (ValueError, TypeError, KeyError, IndexError, pa.ArrowException) as error:
        raise BlockError(f"not results: {error}") from None


def _results(head: Head, batch: pa.RecordBatch) -> ResultsBlock:
    M = batch.num_rows
    estimators = names_of(head.more.get("estimators"), "estimators")
    counters = names_of(head.more.get("counters"), "counters")
    shape = _table_shape(head.more.get("map_shape", [0, 0]))
    inverse = {name: form.values(batch, f"inverse.{name}") for name, form in _INVERSE.items()}
    tables = [
        _NO_TABLE if row is None else np.array(row).reshape(shape) for row in inverse["map_U"]
    ]
    results = Results(
        valves=np.arange(M),
        estimators={
            estimator: EstimatorResults(
                **{
                    name: form.values(batch, f"{estimator}.{name}")
                    for name, form in _ESTIMATOR.items()
                }
            )
            for estimator in estimators
        },
        inverse=InverseResults(**{**inverse, "map_U": tables}),
        counters=_matrix(batch, "counters", pa.int64(), len(counters)),
        counter_names=tuple(counters),
        signals=_signals(batch),
        waiting=[tuple(row) for row in batch_column(batch, "waiting", _NAMES).to_pylist()],
        timing=[tuple(row) for row in batch_column(batch, "timing", _NAMES).to_pylist()],
        recommended=_recommended(batch),
        findings=_findings(batch),
        alarms=_alarms(batch),
        baselines=[_version(row) for row in _objects(batch, "baseline", _BASELINE)],
    )
    names = tuple(batch_column(batch, "valve", pa.string()).to_pylist())
    return ResultsBlock(head.group, head.number, names, results)


_FINDINGS: Final = pa.list_(
    pa.struct([("code", pa.int32()), ("probability", pa.float64()), ("sentence", pa.string())])
)


def _finding_row(one: Finding) -> dict[str, object]:
    return {"code": int(one.code), "probability": one.probability, "sentence": one.sentence}


def _findings(batch: pa.RecordBatch) -> list[tuple[Finding, ...]]:
    return [
        tuple(
            Finding(FindingCode(row["code"]), float(row["probability"]), row["sentence"])
            for row in rows
        )
        for rows in batch_column(batch, "findings", _FINDINGS).to_pylist()
    ]


def _recommended(batch: pa.RecordBatch) -> list[Recommendation]:
    rows = batch_column(batch, "recommended", _NAMES).to_pylist()
    if any(len(row) != len(NOT_YET) for row in rows):
        raise BlockError("column recommended: a name and a reason are needed")
    return [Recommendation(*row) for row in rows]


def _table_shape(said: object) -> tuple[int, int]:
    if not isinstance(said, list) or len(said) != 2:
        raise BlockError("metadata valvemap.map_shape: rows and columns are needed")
    rows, columns = (whole("metadata valvemap.map_shape", n, most=_MOST_OF_TABLE) for n in said)
    return rows, columns


def _signals(batch: pa.RecordBatch) -> SignalResults | None:
    if "signals.t" not in batch.schema.names:
        return None
    columns = [_plain(pa.float64()).values(batch, f"signals.{name}") for name in PUBLISHED]
    return SignalResults(
        t=_plain(TIME).values(batch, "signals.t"),
        quality=_plain(pa.uint8()).values(batch, "signals.quality"),
        values=np.stack(columns, axis=1),
    )


def _reports(alarms: AlarmResults) -> pa.Array:
    """Alarms of the valves that have had any; null for the others."""
    rows = [
        [vars(report) for report in alarms.reports(m)] if version else None
        for m, version in enumerate(alarms.version.tolist())
    ]
    return pa.array(rows, _ALARMS)


def _alarms(batch: pa.RecordBatch) -> AlarmResults | None:
    if "alarms.version" not in batch.schema.names:
        return None
    rows = [
        tuple(AlarmReport(**report) for report in row or ())
        for row in _objects(batch, "alarms.reports", _ALARMS)
    ]
    return AlarmResults(_plain(pa.int64()).values(batch, "alarms.version"), rows.__getitem__)


class _Form(NamedTuple):
    """Conversion of a field of M valves to a column, and back."""

    column: Callable[[Any], pa.Array]
    values: Callable[[pa.RecordBatch, str], Any]


def _plain(kind: pa.DataType) -> _Form:
    return _Form(
        lambda values: times(values) if kind == TIME else pa.array(values, kind),
        lambda batch, name: numpy_of(batch_column(batch, name, kind), kind),
    )


def _new(kind: pa.DataType, without: float) -> _Form:
    """As `_plain`; ``without`` is the value in blocks of workers that do not know the column."""
    plain = _plain(kind)
    return _Form(
        plain.column,
        lambda batch, name: (
            plain.values(batch, name)
            if name in batch.schema.names
            else np.full(batch.num_rows, without)
        ),
    )


def _vectors() -> _Form:
    return _Form(
        lambda values: _rows(np.asarray(values, np.float64)),
        lambda batch, name: _matrix(batch, name, pa.float64(), None),
    )


def _nullable(kind: pa.DataType, pack: Callable[[Any], Any], unpack: Callable[[Any], Any]) -> _Form:
    return _Form(
        lambda values: (
            pa.array([None if v is None else pack(v) for v in values], kind)
            if any(v is not None for v in values)
            else pa.nulls(len(values), kind)
        ),
        lambda batch, name: [None if v is None else unpack(v) for v in _objects(batch, name, kind)],
    )


def _table(values: Sequence[Floats]) -> pa.Array:
    if not any(table.size for table in values):
        return pa.nulls(len(values), _FLOATS)
    return pa.array([table.ravel() if table.size else None for table in values], _FLOATS)


def _survey(found: Survey) -> dict[str, Any]:
    return {f.name: np.ravel(getattr(found, f.name)) for f in fields(Survey)} | {
        name: getattr(found, name) for name in ("share", "condition", "suggested_U", "suggested_dp")
    }


def _as_survey(row: Mapping[str, Any]) -> Survey:
    U, dp = np.array(row["U"]), np.array(row["dp"])
    shape = len(U), len(dp)
    grids = {name: np.array(row[name]).reshape(shape) for name in ("std", "age_s")}
    return Survey(**{**row, **grids, "U": U, "dp": dp})


_KINDS: Final = {Kind.NUMBER: pa.float64(), Kind.COUNT: pa.int64(), Kind.CODE: pa.uint8()}
_ESTIMATOR: Final[Mapping[str, _Form]] = {
    "t": _plain(TIME),
    "quality": _plain(pa.uint8()),
    "theta": _vectors(),
    "std": _vectors(),
    "survey": _nullable(_SURVEY, _survey, _as_survey),
    "change": _nullable(_CHANGE, vars, lambda row: Change(**row)),
    "structure": _nullable(pa.string(), str, str),
    "lags": _nullable(_FLOATS, list, lambda row: (row[0], row[1])),
    **{q.field: _plain(_KINDS[q.kind]) for q in ESTIMATOR_QUANTITIES},
}
_INVERSE: Final[Mapping[str, _Form]] = {
    "t": _plain(TIME),
    "quality": _plain(pa.uint8()),
    "required_U": _plain(pa.float64()),
    "lower": _new(pa.float64(), np.nan),
    "upper": _new(pa.float64(), np.nan),
    "status": _plain(pa.uint8()),
    "map_U": _Form(_table, lambda batch, name: _objects(batch, name, _FLOATS)),
    "armed": _plain(pa.bool_()),
    "feed_forward": _plain(pa.uint8()),
}


def _rows(values: Any) -> pa.Array:  # noqa: ANN401 - an array (M, n)
    M, n = values.shape
    edges = pa.array(np.arange(M + 1, dtype=np.int32) * n)
    return pa.ListArray.from_arrays(edges, pa.array(np.ascontiguousarray(values).ravel()))


def _matrix(batch: pa.RecordBatch, name: str, kind: pa.DataType, n: int | None) -> Any:  # noqa: ANN401
    column = batch_column(batch, name, pa.list_(kind))
    flat = numpy_of(column.flatten(), kind)
    M = len(column)
    n = (len(flat) // M if M else 0) if n is None else n
    edges = np.arange(M + 1) * n
    if (column.offsets.to_numpy() - column.offsets[0].as_py() != edges).any():
        raise BlockError(f"column {name}: its lists must be of equal length")
    return flat.reshape(M, n)


def _lists(values: Sequence[tuple[str, ...]]) -> pa.Array:
    return pa.array([list(row) for row in values], _NAMES)


def _structs(values: Sequence[Version | None], kind: pa.DataType) -> pa.Array:
    if all(v is None for v in values):
        return pa.nulls(len(values), kind)
    rows = [v and {"version": v.version, "t": v.t, "digest": v.digest} for v in values]
    return pa.array(rows, kind)


def _version(row: Mapping[str, Any] | None) -> KnownVersion | None:
    return None if row is None else KnownVersion(**row)


def _objects(batch: pa.RecordBatch, name: str, kind: pa.DataType) -> list[Any]:
    """Return a nullable column as a list."""
    where = batch.schema.get_all_field_indices(name)
    if len(where) != 1 or batch.column(where[0]).type != kind:
        raise BlockError(f"column {name}, of type {kind}, is needed once")
    rows: list[Any] = batch.column(where[0]).to_pylist()
    return rows
