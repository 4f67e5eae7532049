"""Record batches of Arrow as samples by valve."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final

import pyarrow as pa

from valvemap.errors import NoRecording, RecordingError
from valvemap.model.samples import Codes, Samples
from valvemap.storage import columns
from valvemap.storage.arrow_columns import (
    check_types,
    numbers_of,
    qualities_of,
    times_of,
    valves_of,
)
from valvemap.storage.columns import CellError
from valvemap.storage.layout import Columns, Part, with_p2

UNREADABLE: Final = (pa.ArrowException, OSError, UnicodeDecodeError)  # of a damaged file


class ArrowReader:
    """Reads record batches; columns may have any suitable Arrow type."""

    def __init__(
        self,
        path: Path,
        schema: pa.Schema,
        batches: Iterable[pa.RecordBatch],
        total: int,
        close: Callable[[], None],
        found: Columns,
    ) -> None:
        self._columns = found
        check_types(schema, self._columns, path)
        self.ignored = self._columns.ignored
        self._path = path
        self._batches = batches
        self._total = total
        self._done = 0
        self.close = close

    @property
    def fraction(self) -> float:
        """The fraction read, 0 to 1."""
        return min(self._done / self._total, 1.0) if self._total else 1.0

    @property
    def parts(self) -> tuple[Part, ...]:
        """Columns of each valve."""
        return self._columns.parts

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), batch by batch."""
        batches = iter(self._batches)
        while True:
            try:
                batch = next(batches, None)
            except UNREADABLE as error:
                raise damaged(self._path, error, self._done) from error
            if batch is None:
                return
            before, self._done = self._done, self._done + batch.num_rows
            if batch.num_rows:
                yield from self._parsed(batch, before)

    def _parsed(self, batch: pa.RecordBatch, before: int) -> Iterator[tuple[str, Samples]]:
        found = self._columns
        try:
            quality = None if found.quality is None else qualities_of(batch.column(found.quality))
            whose = None if found.valve is None else batch.column(found.valve)
            valves, index = valves_of(whose, batch.num_rows)
            for part in found.parts:
                if part.selects and part.valve not in valves:
                    continue
                samples = _samples(batch, part, quality)
                if part.valve is None:
                    yield from columns.by_valve(samples, valves, index)
                elif not part.selects:
                    yield part.valve, samples
                else:
                    own = samples[index == valves.index(part.valve)]
                    if len(own):
                        yield part.valve, own
        except (UnicodeDecodeError, pa.ArrowException) as error:  # in a cell
            raise damaged(self._path, error, before) from error
        except CellError as error:
            row = before + error.row + 1
            raise RecordingError(f"{self._path}, row {row}: {error}") from None


def damaged(path: Path, error: Exception, row: int) -> RecordingError:
    """Return the error that names a file which cannot be read behind a row."""
    if isinstance(error, FileNotFoundError):
        return NoRecording(f"{path} does not exist")
    sentence = str(error).splitlines()[0] if str(error) else type(error).__name__
    where = f"damaged behind row {row}" if row else "not a recording"
    return RecordingError(f"{path} is {where}: {sentence}")


def _samples(batch: pa.RecordBatch, part: Part, quality: Codes | None) -> Samples:
    numbers = {
        name: scaling(numbers_of(batch.column(place)))
        for name, (place, scaling) in part.numbers.items()
    }
    return with_p2(times_of(batch.column(part.t), part.seconds), quality, numbers)
