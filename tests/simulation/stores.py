"""Files in memory, with the promises that SQLite makes: whole commits, safe once synced."""

from collections import Counter
from dataclasses import replace

from valvemap.errors import StorageError


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
        }
        kept = {name: one for name, one in self.committed.items() if name not in gone}
        self.committed, self.aside = kept | put, [*self.aside, *aside]

    def lose_power(self):
        self.committed = self.durable

    def load(self):
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
