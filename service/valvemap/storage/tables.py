"""Tables of scripts as columns by name: data frames of any library, arrays by column, rows."""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, Final, Literal, cast

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import ConfigurationError, RecordingError

ALLOWED: Final = (
    "a path, a data frame (pandas, polars, pyarrow), a dict of arrays by column, a structured "
    "array, or a list of these or of rows (dicts)"
)
BACKENDS: Final = ("pandas", "polars", "pyarrow")


def is_table(given: object) -> bool:
    """Whether it is a data frame, a mapping of arrays, or a structured array."""
    return isinstance(given, Mapping) or _has_fields(given) or _frame(given) is not None


def of_rows(rows: Sequence[object]) -> dict[str, list[object]] | None:
    """Return columns of rows that are mappings of single values; None if these are no such rows.

    >>> of_rows([{"t": 0, "U": 1.5}, {"t": 1}]), of_rows([{"t": [0, 1]}])
    ({'t': [0, 1], 'U': [1.5, None]}, None)
    """
    if not rows or not all(isinstance(row, Mapping) and _is_single(row) for row in rows):
        return None
    found = [cast("Mapping[str, object]", row) for row in rows]
    names = dict.fromkeys(str(name) for row in found for name in row)
    return {name: [row.get(name) for row in found] for name in names}


def columns_of(table: object, name: str) -> dict[str, object]:
    """Return a table's columns, of equal length.

    An index of datetimes or durations is the column t of a pandas frame that has none; levels of
    an index that have names are columns, too.

    Raises
    ------
    RecordingError
        if it is no table, or a column has no name, stands there twice or has another length.
    """
    if isinstance(table, Mapping):
        found = {str(key): values for key, values in table.items()}
    elif _has_fields(table):
        array = cast("NDArray[Any]", table)
        found = {field: array[field] for field in array.dtype.names or ()}
    else:
        found = _of_frame(table, name)
    if not found:
        raise RecordingError(f"{name} has no columns: a recording has t,U,p1,p2,Q")
    sizes = {key: size_of(values, f"{name}: column {key}") for key, values in found.items()}
    if len(set(sizes.values())) > 1:
        raise RecordingError(f"{name}: columns of equal length are allowed, not {sizes}")
    return found


def size_of(values: object, where: str) -> int:
    """Return a column's length.

    Raises
    ------
    RecordingError
        if it is no column.
    """
    try:
        return len(values)  # type: ignore[arg-type]
    except TypeError:
        raise RecordingError(f"{where} is {values!r}; an array of (N,) is allowed") from None


def without_mask(values: object) -> object:
    """Return the values of a masked array: NaN, NaT or None where it is masked.

    >>> without_mask(np.ma.masked_array([1, 2], [False, True]))
    array([ 1., nan])
    """
    if not isinstance(values, np.ma.MaskedArray):
        return values
    bare, masked = values.filled(), np.ma.getmaskarray(values)
    if not masked.any():
        return bare
    match bare.dtype.kind:
        case "m" | "M":
            return np.where(masked, np.array("NaT", bare.dtype), bare)
        case "i" | "u" | "f":
            return np.where(masked, np.nan, bare.astype(np.float64))
        case _:
            return values.tolist()  # None where it is masked


def series_in(values: object) -> Any:  # noqa: ANN401 - narwhals' series of any library
    """Return a column as narwhals' series, with times in UTC; None if it is no series."""
    nw = None if isinstance(values, np.ndarray | list | tuple) else narwhals()
    if nw is None:
        return None
    series = nw.from_native(values, series_only=True, pass_through=True)
    if not isinstance(series, nw.Series):
        return None
    native = series.to_native()
    zone = getattr(getattr(native, "dtype", None), "tz", None)
    if zone is not None:  # narwhals does not know a zone whose name holds "_"
        series = nw.from_native(native.dt.tz_convert("UTC"), series_only=True)
    return series


def data_frame(table: Mapping[str, NDArray[Any]], backend: str) -> Any:  # noqa: ANN401 - of any library
    """Return a data frame of a library: ``pandas``, ``polars`` or ``pyarrow``.

    Raises
    ------
    ConfigurationError
        if the library is unknown or not installed; names it.
    """
    if backend not in BACKENDS:
        raise ConfigurationError(f"backend {backend!r}; {', '.join(BACKENDS)} are allowed")
    nw = narwhals()
    if nw is None or find_spec(backend) is None:
        missing = "narwhals" if nw is None else backend
        raise ConfigurationError(f"a data frame of {backend} needs it: pip install {missing}")
    kind = cast('Literal["pandas", "polars", "pyarrow"]', backend)
    return nw.from_dict(dict(table), backend=kind).to_native()


@lru_cache(maxsize=1)
def narwhals() -> ModuleType | None:
    """Return narwhals, which data frames need, and mappings of arrays do not; loaded when used."""
    return import_module("narwhals") if find_spec("narwhals") is not None else None


def _has_fields(given: object) -> bool:
    return isinstance(given, np.ndarray) and given.dtype.names is not None and given.ndim == 1


def _is_single(row: Mapping[object, object]) -> bool:
    return all(isinstance(x, str) or not hasattr(x, "__len__") for x in row.values())


def _frame(given: object) -> Any:  # noqa: ANN401 - narwhals' frame of any library
    """Return a data frame by narwhals; None if it is none."""
    nw = narwhals()
    if nw is None:
        return None
    try:
        frame = nw.from_native(given, pass_through=True)
    except nw.exceptions.DuplicateError:
        names = [str(name) for name in getattr(given, "columns", ())]
        twice = ", ".join(dict.fromkeys(name for name in names if names.count(name) > 1))
        kind = type(given).__name__
        raise RecordingError(
            f"{kind}: column {twice} stands there twice: rename or drop one"
        ) from None
    if isinstance(frame, nw.LazyFrame):
        return frame.collect()
    if isinstance(frame, nw.DataFrame):
        return frame
    is_batch = hasattr(frame, "__arrow_c_stream__") and hasattr(frame, "num_rows")
    return nw.from_arrow(frame, backend="pyarrow") if is_batch and find_spec("pyarrow") else None


def _of_frame(table: object, name: str) -> dict[str, object]:
    frame = _frame(table)
    if frame is None:
        missing = "; data frames need narwhals: pip install 'valvemap[dataframes]'"
        hint = "" if narwhals() else missing
        raise RecordingError(f"a {name} is no recording; {ALLOWED} is allowed{hint}")
    others = [key for key in frame.columns if not isinstance(key, str)]
    if others:
        raise RecordingError(
            f"{name}: column {others[0]!r} has no text as its name: name the columns, such as "
            "df.columns = ['t', 'U', 'p1', 'p2', 'Q']"
        )
    found: dict[str, object] = {key: frame[key] for key in frame.columns}
    return dict(_of_index(frame, found)) | found


def _of_index(frame: Any, found: Mapping[str, object]) -> Iterator[tuple[str, object]]:  # noqa: ANN401
    """Yield the columns that the index of a pandas frame holds."""
    nw = narwhals()
    index = None if nw is None else nw.maybe_get_index(frame)
    if nw is None or index is None or not isinstance(index.to_numpy()[:0], np.ndarray):
        return
    for level, given in enumerate(index.names):
        series = series_in(index.get_level_values(level).to_series())
        is_time = series.dtype in (nw.Datetime, nw.Duration)
        named = "t" if is_time and "t" not in found else given
        if isinstance(named, str) and named not in found:
            yield named, series
