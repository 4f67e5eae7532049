"""The samples of one valve of a recording."""

from pathlib import Path

from valvemap.errors import ConfigurationError
from valvemap.model.samples import Samples
from valvemap.storage.layout import Layout
from valvemap.storage.recordings import read_recording


def samples_of(valve: str, file: Path, layout: Layout | None) -> Samples:
    """Return all samples of a valve.

    Raises
    ------
    RecordingError, StorageError
        if the file cannot be read.
    ConfigurationError
        if it has no such valve; names those that there are.
    """
    parts, others = [], set()
    with read_recording(file, layout=layout) as batches:
        for name, samples in batches:
            if name == valve:
                parts.append(samples)
            else:
                others.add(name)
    if not parts:
        there = f"; there is {', '.join(sorted(others))}" if others else ""
        raise ConfigurationError(f"VALVE {valve!r}: {file} has no such valve{there}")
    return Samples.concatenate(parts)
