"""What a worker does with each message: pure but for the store that its engine hands in.

The engine (Quix Streams) commits what is stored, what comes out and how far was read together, or
none of it. So what is stored may be older than what this process knows of a group, after a
transaction that failed or a rebalancing: a mark, new with every message, tells. The memory itself
is packed once for each commit: `Worker.keep`, which the engine calls before it commits.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Protocol

import structlog

from valvemap.errors import BlockError, FleetError
from valvemap.kafka.blocks import read_samples
from valvemap.kafka.catalogue import Catalogue
from valvemap.kafka.commands import Reply, read_command, write_message
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.result_blocks import ResultsBlock, write_results
from valvemap.pipeline.failure_log import log_failure

MEMORY: Final = "memory"
MARK: Final = "mark"

log = structlog.get_logger(__name__)


class Store(Protocol):
    """What is kept of one group, within the engine's transaction."""

    def get_bytes(self, key: str) -> bytes | None:
        """What is kept under a key, if anything."""

    def set_bytes(self, key: str, value: bytes) -> None:
        """Keep it from now on."""


@dataclass(frozen=True)
class _Held:
    group: Group
    mark: bytes


class Worker:
    """Takes messages of any groups; `samples` and `command` return what goes to the results.

    Nothing may be committed before `keep`.

    Parameters
    ----------
    catalogue
        All groups.
    rhythm
        When results are due.
    """

    def __init__(self, catalogue: Catalogue, rhythm: Rhythm) -> None:
        self._catalogue = catalogue
        self._rhythm = rhythm
        self._held: dict[str, _Held] = {}
        self._unkept: dict[str, Store] = {}
        self._own, self._turn = os.urandom(12), 0
        self._unknown: set[str] = set()

    def samples(self, key: bytes | None, message: bytes, store: Store) -> list[bytes]:
        """Learn from a block of samples.

        Raises
        ------
        FleetError
            if what is kept of the group cannot be gone on from, or the block is of a newer
            catalogue: nothing is done with it then.
        """

        def learn(group: Group) -> Iterator[ResultsBlock | Reply]:
            block = read_samples(message)
            self._check(block.group, block.catalogue)
            return group.take(block)

        if self._name(key) is None:
            self._leave(key, message)
            return []
        return self._do(key, store, learn)

    def command(self, key: bytes | None, message: bytes, store: Store) -> list[bytes]:
        """Do what an operator asks for.

        Raises
        ------
        FleetError
            as `samples`.
        """
        return self._do(key, store, lambda group: group.do(read_command(message)))

    def keep(self) -> None:
        """Write what is remembered of the groups that had messages since."""
        for name, store in self._unkept.items():
            held = self._held[name]
            if store.get_bytes(MARK) == held.mark:  # else it was rolled back since
                store.set_bytes(MEMORY, held.group.to_bytes())
        self._unkept.clear()

    def _do(
        self,
        key: bytes | None,
        store: Store,
        what: Callable[[Group], Iterator[ResultsBlock | Reply]],
    ) -> list[bytes]:
        name = self._name(key)
        if name is None:
            self._say_unknown(key)
            return []
        group = self._group(name, store)
        try:
            out = [packed for one in what(group) for packed in _packed(group, one)]
        except BlockError as error:
            group.refuse()
            out = []
            self._say("message left aside", key, error)
        for failure in group.identification.new_failures():
            log_failure(failure)
        self._mark(name, group, store)
        return out

    def _group(self, name: str, store: Store) -> Group:
        """The group as it is kept: as we know it, if we were the last to keep it."""
        held, mark = self._held.get(name), store.get_bytes(MARK)
        if held is not None and mark == held.mark:
            return held.group
        group = Group(self._catalogue.groups[name], self._catalogue.version, self._rhythm)
        packed = store.get_bytes(MEMORY)
        if packed is None:
            log.info("group begun", group=name)
        else:
            afresh = group.remember(packed)
            log.info("group taken over", group=name, block=group.number)
            if afresh:
                log.warning("configured otherwise now, starts afresh", group=name, what=afresh)
        return group

    def _mark(self, name: str, group: Group, store: Store) -> None:
        self._turn += 1
        mark = self._own + self._turn.to_bytes(8, "big")
        self._unkept[name] = store
        store.set_bytes(MARK, mark)
        self._held[name] = _Held(group, mark)

    def _name(self, key: bytes | None) -> str | None:
        name = None if key is None else key.decode("utf-8", "replace")
        return name if name in self._catalogue.groups else None

    def _check(self, group: str, catalogue: int) -> None:
        if catalogue > self._catalogue.version:
            raise FleetError(
                f"group {group}: its samples come under version {catalogue} of the catalogue, this "
                f"is version {self._catalogue.version}: bring the worker's catalogue up to date"
            )

    def _leave(self, key: bytes | None, message: bytes) -> None:
        """A block of no group that we know: of a newer catalogue, of none any more, or none."""
        try:
            block = read_samples(message)
        except BlockError as error:
            self._say("message left aside", key, error)
            return
        self._check(block.group, block.catalogue)
        self._say_unknown(key)

    def _say(self, event: str, key: bytes | None, error: BlockError) -> None:
        log.warning(event, group=(key or b"").decode("utf-8", "replace"), reason=str(error))

    def _say_unknown(self, key: bytes | None) -> None:
        name = (key or b"").decode("utf-8", "replace")
        if name not in self._unknown and len(self._unknown) < _MOST_NAMED:
            self._unknown.add(name)
            log.warning("no such group in the catalogue, its messages are left aside", group=name)


_MOST_NAMED = 1_000


def _packed(group: Group, one: ResultsBlock | Reply) -> list[bytes]:
    """A message, or one for each valve where the results of one of them cannot be packed."""
    if isinstance(one, Reply):
        return [write_message(one)]
    try:
        return [write_results(one)]
    except Exception:  # noqa: BLE001 - a bulkhead: which valve it is turns out next
        return [_packed_alone(group, block) for block in group.alone(one.results)]


def _packed_alone(group: Group, one: ResultsBlock) -> bytes:
    try:
        return write_results(one)
    except Exception as error:  # noqa: BLE001 - a bulkhead: the others are sent
        return write_results(group.stop(one.results, error))
