"""The checkpoint store over reloads: one configuration's states are handed over to the next."""

from collections.abc import Mapping, Sequence

from valvemap.errors import StorageError
from valvemap.pipeline.store_ports import Checkpoint, CheckpointStore
from valvemap.runtime.kept_position import POSITION

_Name = tuple[str, str]


class HandedOver:
    """Wraps a store for the time of a process; fulfils `CheckpointStore` as well.

    After `hand_over`, `load` returns the states handed over in place of the stored ones of their
    names, and no position: the next configuration takes over the source itself. States that the
    store refused, as on a full disk, are part of the next save.
    """

    def __init__(self, store: CheckpointStore) -> None:
        self._store = store
        self._handed: dict[_Name, Checkpoint] | None = None  # None: there was no reload
        self._unsaved: dict[_Name, Checkpoint] = {}

    def hand_over(self, states: Sequence[Checkpoint], *, saved: bool) -> None:
        """Note all states at the end of a configuration, and whether the store has them."""
        self._handed = {_name(one): one for one in states}
        self._unsaved = {} if saved else self._unsaved | self._handed

    def load(self, together: Sequence[Sequence[str]] = ()) -> Sequence[Checkpoint]:
        """Return the newest state of each name; see `CheckpointStore.load`."""
        if self._handed is None:
            return self._store.load(together)
        try:
            stored = self._store.load(together)
        except StorageError:  # a full disk or a lost volume ends no service that runs
            stored = ()
        known = {_name(one): one for one in stored if _name(one) != POSITION}
        return list((known | self._unsaved | self._handed).values())

    def save(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Save all of them and what was refused before, or none."""
        new = {_name(one): one for one in checkpoints}
        self._store.save(list((self._unsaved | new).values()))
        self._unsaved = {}

    def put_aside(
        self,
        aside: Sequence[tuple[Checkpoint, str]],
        moved: Mapping[_Name, _Name],
    ) -> None:
        """Keep states that are not restored; see `CheckpointStore.put_aside`."""
        self._store.put_aside(aside, moved)
        for name in (*(_name(one) for one, _ in aside), *moved):
            self._unsaved.pop(name, None)

    @property
    def waiting(self) -> list[Checkpoint]:
        """The states handed over that the store has refused so far."""
        return list(self._unsaved.values())

    @property
    def size(self) -> int:
        """Size in bytes."""
        return self._store.size

    @property
    def damaged(self) -> Sequence[str]:
        """``<Valve>.<Estimator>`` whose newest state was damaged, unless it was handed over."""
        handed = {".".join(name) for name in self._handed or ()}
        return [name for name in self._store.damaged if name not in handed]


def _name(one: Checkpoint) -> _Name:
    return one.valve, one.estimator
