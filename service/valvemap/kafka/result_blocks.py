"""Results of a group as blocks: one row a valve; `docs/fleet.md` defines the schema.

Tables of the inverse map and surveys are large and computed in turns: a block holds the new ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from valvemap.errors import BlockError
from valvemap.kafka.blocks import (
    TIME,
    Head,
    batch_column,
    names_of,
    read,
    times,
    write,
)
from valvemap.kafka.json_messages import whole
from valvemap.kafka.result_columns import (
    ESTIMATOR_FORMS,
    INVERSE_FORMS,
    TEXTS,
    matrix_of,
    objects_of,
    plain_form,
    row_lists,
    text_lists,
)
from valvemap.pipeline.alarm_results import AlarmReport, AlarmResults
from valvemap.pipeline.recommendation import NOT_YET, Recommendation
from valvemap.pipeline.results import (
    EstimatorResults,
    InverseResults,
    Results,
    SignalResults,
    Version,
)
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.signals import PUBLISHED

_RESULTS: Final = "results"
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
        for name, form in ESTIMATOR_FORMS.items():
            columns[f"{estimator}.{name}"] = form.column(getattr(own, name))
    for name, form in INVERSE_FORMS.items():
        columns[f"inverse.{name}"] = form.column(getattr(found.inverse, name))
    columns["counters"] = row_lists(np.asarray(found.counters, np.int64).reshape(M, -1))
    columns["waiting"] = text_lists(found.waiting or [()] * M)
    columns["timing"] = text_lists(found.timing or [()] * M)
    columns["findings"] = pa.array(
        [[_finding_row(one) for one in own] for own in found.findings or [()] * M], _FINDINGS
    )
    columns["recommended"] = text_lists(found.recommended or [NOT_YET] * M)
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
    inverse = {name: form.values(batch, f"inverse.{name}") for name, form in INVERSE_FORMS.items()}
    tables = [
        _NO_TABLE if row is None else np.array(row).reshape(shape) for row in inverse["map_U"]
    ]
    results = Results(
        valves=np.arange(M),
        estimators={
            estimator: EstimatorResults(
                **{
                    name: form.values(batch, f"{estimator}.{name}")
                    for name, form in ESTIMATOR_FORMS.items()
                }
            )
            for estimator in estimators
        },
        inverse=InverseResults(**{**inverse, "map_U": tables}),
        counters=matrix_of(batch, "counters", pa.int64(), len(counters)),
        counter_names=tuple(counters),
        signals=_signals(batch),
        waiting=[tuple(row) for row in batch_column(batch, "waiting", TEXTS).to_pylist()],
        timing=[tuple(row) for row in batch_column(batch, "timing", TEXTS).to_pylist()],
        recommended=_recommended(batch),
        findings=_findings(batch),
        alarms=_alarms(batch),
        baselines=[_version(row) for row in objects_of(batch, "baseline", _BASELINE)],
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
    rows = batch_column(batch, "recommended", TEXTS).to_pylist()
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
    columns = [plain_form(pa.float64()).values(batch, f"signals.{name}") for name in PUBLISHED]
    return SignalResults(
        t=plain_form(TIME).values(batch, "signals.t"),
        quality=plain_form(pa.uint8()).values(batch, "signals.quality"),
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
        for row in objects_of(batch, "alarms.reports", _ALARMS)
    ]
    return AlarmResults(plain_form(pa.int64()).values(batch, "alarms.version"), rows.__getitem__)


def _structs(values: Sequence[Version | None], kind: pa.DataType) -> pa.Array:
    if all(v is None for v in values):
        return pa.nulls(len(values), kind)
    rows = [v and {"version": v.version, "t": v.t, "digest": v.digest} for v in values]
    return pa.array(rows, kind)


def _version(row: Mapping[str, Any] | None) -> KnownVersion | None:
    return None if row is None else KnownVersion(**row)
