"""The checkpoint store over reloads: one configuration's states are transferred to the next."""

from collections.abc import Awaitable, Callable, Mapping, Sequence

import structlog

from valvemap.errors import StorageError
from valvemap.pipeline.store_ports import Checkpoint, CheckpointStore
from valvemap.runtime.kept_position import POSITION
from valvemap.runtime.state_keeper import StateKeeper

log = structlog.get_logger(__name__)

_Name = tuple[str, str]


class TransferredStates:
    """Wraps a store for the time of a process; fulfils `CheckpointStore` as well.

    After `transfer`, `load` returns the states transferred in place of the stored ones of their
    names, and no position: the next configuration takes over the source itself. States that the
    store refused, as on a full disk, are part of the next save.
    """

    def __init__(self, store: CheckpointStore) -> None:
        self._store = store
        self._transferred: dict[_Name, Checkpoint] | None = None  # None: there was no reload
        self._unsaved: dict[_Name, Checkpoint] = {}

    def transfer(self, states: Sequence[Checkpoint], *, saved: bool) -> None:
        """Take all states at the end of a configuration; ``saved``: the store has them."""
        self._transferred = {_name(one): one for one in states}
        self._unsaved = {} if saved else self._unsaved | self._transferred

    def load(self, together: Sequence[Sequence[str]] = ()) -> Sequence[Checkpoint]:
        """Return the newest state of each name; see `CheckpointStore.load`."""
        if self._transferred is None:
            return self._store.load(together)
        try:
            stored = self._store.load(together)
        except StorageError:  # a full disk or a lost volume ends no service that runs
            stored = ()
        known = {_name(one): one for one in stored if _name(one) != POSITION}
        return list((known | self._unsaved | self._transferred).values())

    def save(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Save all of them and those refused before, or none."""
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
        """The transferred states that the store has refused."""
        return list(self._unsaved.values())

    @property
    def size(self) -> int:
        """Size in bytes."""
        return self._store.size

    @property
    def damaged(self) -> Sequence[str]:
        """``<Valve>.<Estimator>`` whose newest state was damaged, unless it was transferred."""
        transferred = {".".join(name) for name in self._transferred or ()}
        return [name for name in self._store.damaged if name not in transferred]


async def transfer(
    keeper: StateKeeper, keep: Callable[[], Awaitable[bool]], store: TransferredStates
) -> None:
    """Save the states of a configuration that ends, and transfer them, saved or not.

    ``keep`` saves them, and returns whether all were saved.
    """
    states, saved = keeper.states(), False
    try:
        saved = await keep()
    except StorageError as error:
        log.warning("checkpoint not saved, its states are transferred", reason=str(error))
    store.transfer(states, saved=saved)


def _name(one: Checkpoint) -> _Name:
    return one.valve, one.estimator
