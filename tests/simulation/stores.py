"""Files in memory, with the promises that SQLite makes: whole commits, safe once synced.

In some seeds the history is the real file, on a disk that fills up.
"""

import shutil
import tempfile
from collections import Counter
from dataclasses import replace
from typing import ClassVar, Final

from guarded_opcua.history.historian import EVER
from valvemap.errors import StorageError
from valvemap.storage.history import HistoryFile
from valvemap.vocabulary.history_columns import REQUIRED_U

_EVERY_PAGE: Final = 2**32 - 2  # SQLite's default for the largest number of pages


class StateFile:
    """The checkpoint store. A commit is whole; a loss of power takes those not synced."""

    size = 0
    damaged = ()

    def __init__(self):
        self.committed = {}
        self.durable = {}
        self.aside = []  # (checkpoint, reason)
        self.refuses = False
        self.saves = 0

    def save(self, checkpoints):
        if self.refuses:
            raise StorageError("state: disk full")
        rows = {(one.valve, one.estimator): one for one in checkpoints}
        self.committed = self.committed | rows
        self.saves += 1
        self.sync()

    def sync(self):
        self.durable = self.committed

    def put_aside(self, aside, moved):
        gone = {(one.valve, one.estimator) for one, _ in aside} | moved.keys()
        put = {
            new: replace(self.committed[old], valve=new[0], estimator=new[1])
            for old, new in moved.items()
            if old in self.committed
        }
        kept = {name: one for name, one in self.committed.items() if name not in gone}
        self.committed, self.aside = kept | put, [*self.aside, *aside]

    def lose_power(self):
        self.committed = self.durable

    def load(self, _together=()):
        return list(self.committed.values())


class PastFile:
    """The history: rows by series."""

    lost = 0
    size = 0

    def __init__(self):
        self.rows = Counter()
        self.refuses = False

    def save(self, pieces):
        new = Counter()
        for piece in pieces:
            new[piece.series] += len(piece.t)
        if self.refuses:
            raise StorageError("history: disk full")
        self.rows += new
        return 0

    def note(self, changes):
        if self.refuses:
            raise StorageError("history: disk full")

    def forget(self):
        return 0

    def take_notes(self):
        return ()

    def start(self):
        """A process opens the file."""
        self.refuses = False

    def die(self):
        """The process ends: it writes nothing more."""
        self.refuses = True

    def remove(self):
        pass


def column_of(series):
    """A column that all rows of a series have."""
    return {"Signals": "Q", "Inverse": REQUIRED_U}.get(series.rpartition(".")[2], "Residual")


class RealPastFile:
    """The history in its file; each process opens it. While it refuses, its disk is full."""

    def __init__(self, folder, time):
        self._folder = tempfile.mkdtemp(dir=folder)
        self._time = time
        self._file = None

    def start(self):
        self._file = HistoryFile(f"{self._folder}/history", clock=self._time.monotonic)

    def die(self):
        self._file.close()
        self._file = None

    rows: ClassVar = Counter()

    def remove(self):
        """The world has ended."""
        shutil.rmtree(self._folder)

    @property
    def refuses(self):
        return self._file is None

    @refuses.setter
    def refuses(self, full):
        if self._file is not None:
            most = 1 if full else _EVERY_PAGE  # 1: no page more than there are
            self._file._database.writer.execute(f"PRAGMA max_page_count = {most}").fetchall()

    def times(self, series):
        """The times of all rows of a series."""
        past = self._file.read(series, column_of(series), *EVER, most=1_000_000)
        return set(past.t.tolist())

    def __getattr__(self, name):
        if self._file is None:
            raise StorageError("history: its process has ended")
        return getattr(self._file, name)
