"""Fields of results as columns of a block, and back."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from valvemap.errors import BlockError
from valvemap.kafka.blocks import (
    TIME,
    batch_column,
    numpy_of,
    times,
)
from valvemap.model.change import Change
from valvemap.model.samples import Floats
from valvemap.model.survey import Survey
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, Kind

_FLOATS: Final = pa.list_(pa.float64())
TEXTS: Final = pa.list_(pa.string())
_SURVEY: Final = pa.struct(
    [(name, _FLOATS) for name in ("U", "dp", "std", "age_s")]
    + [(name, pa.float64()) for name in ("share", "condition", "suggested_U", "suggested_dp")]
)
_CHANGE: Final = pa.struct(
    [("count", pa.int64()), ("sample", pa.int64()), ("t", pa.int64()), ("size", pa.float64())]
)


class Form(NamedTuple):
    """Conversion of a field of M valves to a column, and back."""

    column: Callable[[Any], pa.Array]
    values: Callable[[pa.RecordBatch, str], Any]


def plain_form(kind: pa.DataType) -> Form:
    """Conversion of M values of one type."""
    return Form(
        lambda values: times(values) if kind == TIME else pa.array(values, kind),
        lambda batch, name: numpy_of(batch_column(batch, name, kind), kind),
    )


def new_form(kind: pa.DataType, without: float) -> Form:
    """As `plain_form`; ``without`` is the value in blocks of older workers."""
    plain = plain_form(kind)
    return Form(
        plain.column,
        lambda batch, name: (
            plain.values(batch, name)
            if name in batch.schema.names
            else np.full(batch.num_rows, without)
        ),
    )


def vector_form() -> Form:
    """Conversion of M vectors of equal length, (M, n)."""
    return Form(
        lambda values: row_lists(np.asarray(values, np.float64)),
        lambda batch, name: matrix_of(batch, name, pa.float64(), None),
    )


def nullable_form(
    kind: pa.DataType, pack: Callable[[Any], Any], unpack: Callable[[Any], Any]
) -> Form:
    """Conversion of M objects, None for null."""
    return Form(
        lambda values: (
            pa.array([None if v is None else pack(v) for v in values], kind)
            if any(v is not None for v in values)
            else pa.nulls(len(values), kind)
        ),
        lambda batch, name: [
            None if v is None else unpack(v) for v in objects_of(batch, name, kind)
        ],
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
ESTIMATOR_FORMS: Final[Mapping[str, Form]] = {
    "t": plain_form(TIME),
    "quality": plain_form(pa.uint8()),
    "theta": vector_form(),
    "std": vector_form(),
    "survey": nullable_form(_SURVEY, _survey, _as_survey),
    "change": nullable_form(_CHANGE, vars, lambda row: Change(**row)),
    "structure": nullable_form(pa.string(), str, str),
    "lags": nullable_form(_FLOATS, list, lambda row: (row[0], row[1])),
    **{q.field: plain_form(_KINDS[q.kind]) for q in ESTIMATOR_QUANTITIES},
}
INVERSE_FORMS: Final[Mapping[str, Form]] = {
    "t": plain_form(TIME),
    "quality": plain_form(pa.uint8()),
    "required_U": plain_form(pa.float64()),
    "lower": new_form(pa.float64(), np.nan),
    "upper": new_form(pa.float64(), np.nan),
    "status": plain_form(pa.uint8()),
    "map_U": Form(_table, lambda batch, name: objects_of(batch, name, _FLOATS)),
    "armed": plain_form(pa.bool_()),
    "feed_forward": plain_form(pa.uint8()),
}


def row_lists(values: Any) -> pa.Array:  # noqa: ANN401 - an array (M, n)
    """Return an array as a column of lists, one a row."""
    M, n = values.shape
    edges = pa.array(np.arange(M + 1, dtype=np.int32) * n)
    return pa.ListArray.from_arrays(edges, pa.array(np.ascontiguousarray(values).ravel()))


def matrix_of(batch: pa.RecordBatch, name: str, kind: pa.DataType, n: int | None) -> Any:  # noqa: ANN401
    """Return a column of lists of equal length as an array (M, n); ``n`` None: as they come."""
    column = batch_column(batch, name, pa.list_(kind))
    flat = numpy_of(column.flatten(), kind)
    M = len(column)
    n = (len(flat) // M if M else 0) if n is None else n
    edges = np.arange(M + 1) * n
    if (column.offsets.to_numpy() - column.offsets[0].as_py() != edges).any():
        raise BlockError(f"column {name}: its lists must be of equal length")
    return flat.reshape(M, n)


def text_lists(values: Sequence[tuple[str, ...]]) -> pa.Array:
    """Return tuples of texts as a column of lists."""
    return pa.array([list(row) for row in values], TEXTS)


def objects_of(batch: pa.RecordBatch, name: str, kind: pa.DataType) -> list[Any]:
    """Return a nullable column as a list."""
    where = batch.schema.get_all_field_indices(name)
    if len(where) != 1 or batch.column(where[0]).type != kind:
        raise BlockError(f"column {name}, of type {kind}, is needed once")
    rows: list[Any] = batch.column(where[0]).to_pylist()
    return rows
