"""The file formats of recordings, by the names of the files."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from valvemap.errors import NoRecording, RecordingError
from valvemap.storage.packed_text import PACKINGS

_PART = re.compile(r"(\.\d+)?\.part$", re.IGNORECASE)


def form_of(path: Path) -> tuple[str, bool]:
    """Return the suffix of a recording's format, and whether it is the part of a killed writer.

    Raises
    ------
    NoRecording
        if it is a folder, or has another suffix.
    """
    name = path.name.casefold()
    whole = _PART.sub("", name)
    for suffix in (*PACKINGS, ".parquet"):
        if whole.endswith(suffix):
            return suffix, whole != name
    if path.is_dir():
        raise NoRecording(f"{path} is a folder: name its recordings, in the order of time")
    raise NoRecording(
        f"{path} is not a recording: its name must end in {', '.join(PACKINGS)} or .parquet"
    )


@contextmanager
def extra_of_parquet() -> Iterator[None]:
    """Name the extra that is missing where pyarrow cannot be imported."""
    try:
        yield
    except ImportError as error:
        raise RecordingError(
            "Parquet recordings need pyarrow: pip install 'valvemap[parquet]'"
        ) from error
