"""Variables that change together, stored and written as arrays.

Writing variables one at a time costs about 10 µs of Python per change. A block is written as
arrays, and its monitored items are served as arrays by ``block_items``. Clients see no difference.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from asyncua import ua
from asyncua.server.address_space import AttributeValue
from numpy.typing import ArrayLike, NDArray
from typing_extensions import override

from guarded_opcua.address_space.batches import Batch, Columns, Values, Watcher
from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.address_space.watchers import notify
from guarded_opcua.binary.encoding import DTYPES, TICKS_1970, instant, ticks, ticks_of_ns
from guarded_opcua.errors import ServerError
from guarded_opcua.ledger import Ledger

_UNCERTAIN, _BAD = 0x4000_0000, 0x8000_0000


class Block:
    """The newest values of n variables of one type, one column each.

    Created by ``HardenedServer.add_block``. The initial status is BadWaitingForInitialData; ``now``
    is UTC ns.

    Attributes
    ----------
    type
        Data type: a number of fixed width.
    length
        Length of the values if they are arrays, None for scalars.
    """

    def __init__(
        self, type_: ua.VariantType, n: int, length: int | None, ledger: Ledger, now: int
    ) -> None:
        self.type = type_
        self.length = length
        self.dtype = np.dtype(DTYPES.get(type_, np.float64))
        width = 1 if length is None else length
        self.watchers: list[Watcher] = []
        self._ledger = ledger
        self._values = np.zeros((n, width), self.dtype)
        self._codes = np.full(n, ua.StatusCodes.BadWaitingForInitialData, np.uint32)
        self._has = np.zeros(n, np.bool_)
        self._source = np.full(n, ticks_of_ns(now), np.int64)
        self._server = self._source.copy()
        self._held: dict[int, AttributeValue] = {}  # of columns with a variable
        self._watched: set[int] = set()  # columns with callbacks of single items

    def __len__(self) -> int:
        return len(self._values)

    def check(self, variable: Variable) -> None:
        """Check that a variable can be attached to a column.

        Raises
        ------
        ServerError
            if its type differs from the block's.
        """
        if variable.type != self.type or self.type not in DTYPES:
            raise ServerError(f"{variable.id.Identifier}: a block is of numbers of one type")
        if variable.array != (self.length is not None):
            raise ServerError(f"{variable.id.Identifier}: a block is of scalars, or of arrays")

    def adopt(self, column: int, data: ua.DataValue) -> None:
        """Copy the previous value of a variable to its column."""
        self._values[column], *rest = self._content(data)
        self._codes[column], self._has[column], self._source[column] = rest[:3]
        self._server[column] = rest[3]

    def show(self, column: int, variable: Variable, held: AttributeValue) -> None:
        """Attach a variable to a column; ``held`` is its attribute Value."""
        self.check(variable)
        held.value_callback = self._reader(column)
        held.datachange_callbacks = _Callbacks(held.datachange_callbacks, self._watched, column)
        self._held[column] = held

    @property
    def width(self) -> int:
        """Number of elements of each value."""
        return self._values.shape[1]

    def batch(
        self,
        values: ArrayLike,
        source_times: ArrayLike,
        codes: ArrayLike,
        present: ArrayLike | None,
        now: int,
        columns: ArrayLike | None = None,
    ) -> Batch:
        """Return a batch of the samples of all or the given columns; times in UTC ns.

        Raises
        ------
        ValueError
            if the shapes are inconsistent.
        """
        found = np.array(values, self.dtype)  # a copy, since it may be queued
        written = None if columns is None else np.asarray(columns, np.intp)
        width = len(self) if written is None else len(written)
        shape = (-1, width) if self.length is None else (-1, width, self.length)
        if found.ndim != len(shape) or found.shape[1:] != shape[1:]:
            raise ValueError(f"values: shape {found.shape}, allowed is {shape}, -1 = any")
        k, n = found.shape[:2]
        source = np.asarray(source_times, np.int64)
        if source.ndim == 1:
            source = source[:, None]
        codes = _spread(np.asarray(codes, np.uint32), (k, n))
        there = None if present is None else np.asarray(present, np.bool_)
        if there is not None and there.all():
            there = None
        return Batch(
            values=found.reshape(k, n, -1),
            codes=codes,
            has=codes < _BAD,
            source=_spread(source // 100 + TICKS_1970, (k, n)),
            server=ticks_of_ns(now),
            present=None if there is None else _spread(there, (k, n)),
            columns=written,
        )

    def batch_of(self, column: int, data: ua.DataValue) -> Batch:
        """Return a batch of one value of one variable."""
        n = len(self)
        value, code, has, source, server = self._content(data)
        return Batch(
            np.full((1, n, self.width), value, self.dtype),
            np.full((1, n), code, np.uint32),
            np.full((1, n), has),
            np.full((1, n), source),
            server,
            np.arange(n)[None] == column,
        )

    def take(self, batch: Batch) -> None:
        """Store the next samples, and notify the monitored items."""
        if not batch.codes.size or (batch.present is not None and not batch.present.any()):
            return
        moment = self._ledger.moment + 1
        for row, column, data in self._for_others(batch):
            self._ledger.moment = moment + row * len(self) + column
            notify(self._held[column], data)
        for items in self.watchers:
            items.take_in(batch, moment)
        self._ledger.moment = moment + len(batch) * len(self)
        self._store(batch)

    def current(self, column: int) -> ua.DataValue:
        """Return the newest value of a variable."""
        return self.data_value(
            self._values[column],
            int(self._codes[column]),
            bool(self._has[column]),
            int(self._source[column]),
            int(self._server[column]),
        )

    def newest(self, column: int) -> Batch:
        """Return the newest value of a variable as a batch with a single column."""
        one = slice(column, column + 1)
        return Batch(
            self._values[None, one].copy(),
            self._codes[None, one].copy(),
            self._has[None, one].copy(),
            self._source[None, one].copy(),
            int(self._server[column]),
            None,
        )

    def data_value(
        self,
        value: Values,
        code: int,
        has: bool,  # noqa: FBT001 - an element of an array
        source: int,
        server: int,
    ) -> ua.DataValue:
        """Return a DataValue of array elements."""
        if not has:
            content = ua.Variant()
        elif self.length is None:
            content = ua.Variant(value[0].item(), self.type)
        else:
            content = ua.Variant(value.tolist(), self.type, is_array=True)
        return ua.DataValue(content, ua.StatusCode(code), _instant(source), _instant(server))

    def marked(self, code: int, now: int, columns: Columns | None = None) -> Batch:
        """Return a batch of the newest values, of all or the given columns, with a new status."""
        which = slice(None) if columns is None else columns
        return Batch(
            self._values[None, which].copy(),
            np.full((1, len(self) if columns is None else len(columns)), code, np.uint32),
            self._has[None, which].copy(),
            self._source[None, which].copy(),
            ticks_of_ns(now),
            None,
            columns,
        )

    def are_good(self, columns: Columns) -> NDArray[np.bool_]:
        """Return whether the newest values of the columns are Good, shape (n,)."""
        return np.asarray(self._codes[columns] < _UNCERTAIN)

    def unknown(self, columns: Sequence[int], now: int) -> Batch:
        """Return a batch with BadNodeIdUnknown for the columns of removed variables."""
        one = () if self.length is None else (self.length,)
        values = np.zeros((1, len(columns), *one), self.dtype)
        return self.batch(values, [now], ua.StatusCodes.BadNodeIdUnknown, None, now, columns)

    def _content(self, data: ua.DataValue) -> tuple[Any, int, bool, int, int]:
        """Return value (0 if null), code, whether it has a value, source and server time."""
        has = data.Value is not None and data.Value.Value is not None
        code = 0 if data.StatusCode is None else data.StatusCode.value
        server = 0 if data.ServerTimestamp is None else ticks(data.ServerTimestamp)
        source = server if data.SourceTimestamp is None else ticks(data.SourceTimestamp)
        return data.Value.Value if has else 0, code, has, source, server

    def _reader(self, column: int) -> Callable[[ua.NodeId, ua.AttributeIds], ua.DataValue]:
        return lambda _node, _attribute: self.current(column)

    def _store(self, batch: Batch) -> None:
        where: Columns | slice = slice(None) if batch.columns is None else batch.columns
        row: int | NDArray[np.intp] = -1
        there: Columns | slice = slice(None)
        if batch.present is not None:
            there = np.flatnonzero(batch.present.any(axis=0))
            row = len(batch) - 1 - np.argmax(batch.present[::-1, there], axis=0)
            where = there if batch.columns is None else batch.columns[there]
        self._values[where] = batch.values[row, there]
        self._codes[where] = batch.codes[row, there]
        self._has[where] = batch.has[row, there]
        self._source[where] = batch.source[row, there]
        self._server[where] = batch.server

    def _for_others(self, batch: Batch) -> Iterator[tuple[int, int, ua.DataValue]]:
        """Yield (row, column, value) of the samples of variables with single items, in order."""
        watched = self._watched
        if not watched:
            return
        if batch.columns is None:
            pairs = [(column, column) for column in sorted(watched)]
        else:
            columns = enumerate(batch.columns.tolist())
            pairs = sorted((column, n) for n, column in columns if column in watched)
        for row in range(len(batch)):
            for column, n in pairs:
                if batch.present is None or batch.present[row, n]:
                    yield (
                        row,
                        column,
                        self.data_value(
                            batch.values[row, n],
                            int(batch.codes[row, n]),
                            bool(batch.has[row, n]),
                            int(batch.source[row, n]),
                            batch.server,
                        ),
                    )


class _Callbacks(dict[int, Callable[..., Any]]):
    """Callbacks of single items on one variable; keeps the block's ``watched`` set up to date."""

    def __init__(self, held: dict[int, Callable[..., Any]], watched: set[int], column: int) -> None:
        super().__init__(held)
        self._watched, self._column = watched, column
        if held:
            watched.add(column)

    @override
    def __setitem__(self, handle: int, callback: Callable[..., Any]) -> None:
        super().__setitem__(handle, callback)
        self._watched.add(self._column)

    @override
    def pop(self, handle: int, *default: Any) -> Any:
        callback = super().pop(handle, *default)
        if not self:
            self._watched.discard(self._column)
        return callback


def _spread(array: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    return array if array.shape == shape else np.broadcast_to(array, shape)


@lru_cache(maxsize=64)  # the signals of a sample share their timestamps
def _instant(ticks_: int) -> Any:  # noqa: ANN401 - a datetime of asyncua's
    return instant((ticks_ - TICKS_1970) * 100)
