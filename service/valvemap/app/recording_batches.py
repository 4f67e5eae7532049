"""Recordings as batches of samples, in memory of constant size, divided among edges and meters."""

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from valvemap.foreign_text import printable
from valvemap.model.samples import Floats, Samples
from valvemap.pipeline.edges import Splitter, gathered
from valvemap.pipeline.meters import Meters
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.storage.layout import Layout, Part
from valvemap.storage.recordings import read_recording

MOST_SPLIT: Final = 1 << 20  # samples of an edge that wait for the same rows of its line
_MOST_NAMED: Final = 12  # columns of a line
_LIBRARY: Final = __name__.partition(".")[0]
T = TypeVar("T")
Progress = Callable[[Path, float], None]
Note = Callable[[str], None]
UnitCheck = Callable[[Path, str, Samples, Part], None]


def read_batches(
    recording: object,
    layout: Layout,
    progress: Progress,
    turn: Callable[[Iterator[tuple[str, Samples]]], Iterator[tuple[str, Samples]]],
    check: UnitCheck = lambda _file, _valve, _samples, _part: None,
    note: Note = lambda _line: None,
) -> Iterator[tuple[str, Samples]]:
    """Yield name and samples of each batch; ``turn`` may read ahead.

    ``check`` is called with a valve's first samples of the recording, and its columns; ``note``
    at the end, with a line that names the columns of no valve.
    """
    file, checked = name_of(recording), set[str]()
    with read_recording(recording, layout=layout) as batches:
        progress(file, 0.0)
        for name, samples in turn(batches):
            if name not in checked and len(samples):
                checked.add(name)
                own = [part for part in batches.parts if part.valve in (None, name)]
                for part in own[:1]:
                    check(file, name, samples, part)
            yield name, samples
            progress(file, batches.fraction)
        if batches.ignored:
            note(f"{file.name}: columns not used: {_listed(batches.ignored)}")


def as_warning(line: str) -> None:
    """Warn a script of an omitted part, at the line that called the library."""
    frame, level = sys._getframe(), 1  # noqa: SLF001 - as `warnings` itself counts
    while frame.f_back and str(frame.f_globals.get("__name__")).partition(".")[0] == _LIBRARY:
        frame, level = frame.f_back, level + 1
    warnings.warn(line, stacklevel=level)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMED
    shown = ", ".join(printable(name) for name in names[:_MOST_NAMED])
    return f"{shown} and {more:,} more" if more > 0 else shown


def one_ahead(items: Iterator[T]) -> Iterator[T]:
    """Yield the items; a thread reads the next one while the current one is processed."""
    with ThreadPoolExecutor(1) as thread:
        coming = thread.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = thread.submit(next, items, None)
            yield item


def name_of(recording: object) -> Path:
    """Return a file, or the name of a table's type."""
    return recording if isinstance(recording, Path) else Path(type(recording).__name__)


class FlowSplitting:
    """Splits the samples of valves with ports and of shared meters, batch by batch."""

    def __init__(self, plans: Mapping[str, ValvePlan]) -> None:
        self._names = list(plans)
        self._splitter = Splitter(
            [plan.part for plan in plans.values()], self._names, most=MOST_SPLIT
        )
        self._meters = Meters(
            [plan.meter for plan in plans.values()],
            [plan.U_range for plan in plans.values()],
            most=MOST_SPLIT,
        )
        self._lines = {plan.name for plan in plans.values() if plan.part and plan.part.edge is None}

    def take(self, name: str, samples: Samples, use: Callable[[str, Samples], Floats]) -> None:
        """Call ``use`` with samples; of a line it returns the leakage, for those of its edges."""
        if not (self._splitter or self._meters):
            use(name, samples)
            return
        number, coming = self._names.index(name), {}
        if name in self._lines:
            self._splitter.note_leakage(number, samples.t, use(name, samples))
        else:
            coming[number] = samples
        arrived, of_meters = self._meters.share(gathered(coming), _raise)
        arrived, used = self._splitter.split(arrived, _raise)
        for m, start, stop in zip(*(x.tolist() for x in arrived.segments), strict=True):
            rows = np.arange(start, stop)[of_meters.get(m, used[start:stop])]
            if len(rows):
                use(self._names[m], arrived.samples[rows])


def _raise(_: int, error: Exception) -> None:
    raise error
