"""Exports the history of the service as a recording."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from valvemap.config.models import Config
from valvemap.errors import ConfigurationError, NoSuchFile, RecordingError
from valvemap.model.samples import Floats, Samples
from valvemap.runtime.past_pieces import signals_of
from valvemap.storage.history import HistoryFile
from valvemap.storage.recording_writer import RecordingWriter
from valvemap.vocabulary.signals import MEASURED
from valvemap.vocabulary.statuses import Quality

ROWS = 100_000  # per read


def export_history(
    config: Config,
    out: Path,
    valves: Sequence[str],
    start: int,
    stop: int,
    progress: Callable[[int], None] = lambda _n: None,
) -> int:
    """Write the samples of the given valves from ``start`` to ``stop``, UTC ns, as a recording.

    Returns
    -------
    int
        Number of samples.

    Raises
    ------
    ConfigurationError
        if there is no history, or no such valve.
    RecordingError
        if the history has no samples in that span.
    StorageError
        if a file cannot be read or written; names the file.
    """
    file = config.history.file
    if file is None:
        raise ConfigurationError("history.file is not set: no history is kept; name a file there")
    if not file.exists():
        raise NoSuchFile(f"{file}: no such file; `valvemap serve` makes it")
    known = [valve.name for valve in config.valves]
    unknown = [name for name in valves if name not in known]
    if unknown:
        raise ConfigurationError(f"valve '{unknown[0]}': there are {', '.join(known)}")
    n = 0
    with HistoryFile(file, mends=False) as store, RecordingWriter(out) as recording:
        for valve in valves or known:
            for samples in _samples(store, valve, start, stop):
                recording.append(valve, samples)
                n += len(samples)
                progress(n)
        if not n:
            recording.discard()
    if not n:
        raise RecordingError(f"{file}: nothing is known of that span; ask for another one")
    return n


def _samples(store: HistoryFile, valve: str, start: int, stop: int) -> Iterator[Samples]:
    series = signals_of(valve)
    while True:
        rows = store.read(series, "Q", start, stop, most=ROWS)
        if not len(rows.t):
            return
        last = int(rows.t[-1])
        columns: dict[str, Floats] = {
            name: store.read(series, name, start, last, most=ROWS).values for name in MEASURED
        }
        quality = np.minimum(rows.codes >> 30, int(Quality.BAD)).astype(np.uint8)
        measured = ~np.isnan(rows.values)  # rows that mark a loss have no sample
        samples = Samples.of(rows.t, **columns, quality=quality)
        yield samples[measured]
        start = last + 1
