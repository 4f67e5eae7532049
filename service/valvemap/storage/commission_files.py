"""The files of a commissioning run: samples as a recording, and the audit record (JSON lines).

Both are appended and flushed with every batch, so a killed run loses nothing that was received.
"""

import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Self

from valvemap.model.samples import Samples
from valvemap.owned_files import naming
from valvemap.storage.closing import Closing
from valvemap.storage.csv_writing import csv_header, csv_rows
from valvemap.storage.recordings import read_recording
from valvemap.vocabulary.commission import Phase

_AUDIT: Final = ".audit.jsonl"


def new_run(folder: Path, valve: str, now: int) -> Path:
    """Return the recording of a run that starts ``now`` (UTC ns)."""
    return folder / f"{valve}.{datetime.fromtimestamp(now / 1e9, UTC):%Y%m%dT%H%M%SZ}.csv"


def last_run(folder: Path, valve: str) -> Path | None:
    """Return the recording of the newest run that was not refused, None without one."""
    return next(_runs(folder, valve), None)


def last_sampled_run(folder: Path, valve: str) -> Path | None:
    """Return the newest such recording that has samples, None without one."""
    least = len(csv_header())
    return next((f for f in _runs(folder, valve) if f.stat().st_size > least), None)


def _runs(folder: Path, valve: str) -> Iterator[Path]:
    form = re.compile(re.escape(valve) + r"\.\d{8}T\d{6}Z\.csv")
    if folder.is_dir():
        found = sorted(
            (file for file in folder.iterdir() if form.fullmatch(file.name)), reverse=True
        )
        yield from (file for file in found if not _was_refused(file, valve))


def _was_refused(recording: Path, valve: str) -> bool:
    """Whether the run ended before its first command."""
    if RunFiles(recording, valve).elapsed() > 0.0:
        return False
    return any(note.get("phase") == Phase.REFUSED.name for note in _notes(recording))


def why_unfinished(recording: Path) -> str | None:
    """Why a guided run did not reach its end, empty if it did; None of any other recording."""
    if not recording.with_suffix(_AUDIT).is_file():
        return None
    found = "the guided run did not end"
    for note in _notes(recording):
        if note.get("event") == "started":
            found = "the guided run did not end"
        elif note.get("event") == "ended":
            done = note.get("phase") == Phase.DONE.name
            found = "" if done else f"the guided run was ended: {note.get('reason')}"
    return found


def _notes(recording: Path) -> Iterator[dict[str, Any]]:
    """Yield the lines of the audit record beside a recording; none without one."""
    audit = recording.with_suffix(_AUDIT)
    with naming(audit):
        text = audit.read_text(encoding="utf-8", errors="replace") if audit.is_file() else ""
    for line in text.splitlines():
        with suppress(ValueError):  # half a line, at a kill
            note = json.loads(line)
            if isinstance(note, dict):
                yield note


class RunFiles(Closing):
    """The recording ``<Valve>.<time>.csv`` and the audit record ``<Valve>.<time>.audit.jsonl``.

    Parameters
    ----------
    recording
        Path of the recording, see `new_run` and `last_run`; if it is there, the run is resumed.

    Raises
    ------
    StorageError
        naming the file.
    """

    def __init__(self, recording: Path, valve: str) -> None:
        self.recording = recording
        self.audit = recording.with_suffix(_AUDIT)
        self._valve = valve
        self._resumes = recording.is_file()

    def __enter__(self) -> Self:
        with naming(self.recording):
            self.recording.parent.mkdir(parents=True, exist_ok=True)
            if self._resumes:
                _drop_half_line(self.recording)
            self._rows = self.recording.open("ab")
            if not self._rows.tell():
                self._rows.write(csv_header())
        with naming(self.audit):
            self._audit = self.audit.open("a", encoding="utf-8")
        return self

    def close(self) -> None:
        """Close both files."""
        self._rows.close()
        self._audit.close()

    def append(self, samples: Samples) -> None:
        """Append samples to the recording.

        Raises
        ------
        StorageError
        """
        with naming(self.recording):
            self._rows.write(csv_rows(self._valve, samples))
            self._rows.flush()

    def note(self, what: Mapping[str, Any]) -> None:
        """Append a line to the audit record.

        Raises
        ------
        StorageError
        """
        with naming(self.audit):
            self._audit.write(json.dumps(what, ensure_ascii=False) + "\n")
            self._audit.flush()

    def before(self) -> Iterator[Samples]:
        """Yield the samples of the interrupted run; none without one.

        Raises
        ------
        RecordingError
        """
        if self._resumes:
            with read_recording(self.recording) as batches:
                for valve, samples in batches:
                    if valve == self._valve:
                        yield samples

    def elapsed(self) -> float:
        """Return the schedule's time that the interrupted run reached, s; 0 without one."""
        found = 0.0
        for note in _notes(self.recording) if self._resumes else ():
            elapsed = note.get("elapsed_s")
            found = float(elapsed) if isinstance(elapsed, int | float) else found
        return found


def _drop_half_line(file: Path) -> None:
    """Cut what a killed run left behind the last complete line."""
    with file.open("rb+") as rows:
        content = rows.read()
        rows.truncate(content.rfind(b"\n") + 1)
        rows.flush()
        os.fsync(rows.fileno())
