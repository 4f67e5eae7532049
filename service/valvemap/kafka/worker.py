"""Processes messages of a worker: pure, except for the store passed in by the engine.

The engine (Quix Streams) commits the store, the output and the offsets in one transaction. After
a failed transaction or a rebalancing, the store may therefore be older than the group in memory.
A mark, renewed with every message, detects that. The checkpoint itself is encoded once for each
commit by `Worker.keep`, which the engine calls before it commits.
"""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol, TypeVar

import structlog

from valvemap.errors import BlockError, DamagedState
from valvemap.kafka.blocks import SamplesBlock
from valvemap.kafka.catalogue import Catalogue
from valvemap.kafka.commands import Command, Reply, write_message
from valvemap.kafka.dead_letters import DeadLetter, RejectionLog
from valvemap.kafka.decoding import ROW_BYTES, Decoder, Rejected, Tracebacks
from valvemap.kafka.group import AHEAD, DAMAGED, Group, Rhythm
from valvemap.kafka.result_blocks import ResultsBlock, write_results
from valvemap.kafka.settings import TopicsConfig
from valvemap.kafka.worker_metrics import WorkerMetrics
from valvemap.runtime.failure_log import log_failure

MEMORY: Final = "memory"
MARK: Final = "mark"

log = structlog.get_logger(__name__)


class Store(Protocol):
    """State store of one group, within the engine's transaction."""

    def get_bytes(self, key: str) -> bytes | None:
        """Return the value of a key, None if missing."""

    def set_bytes(self, key: str, value: bytes) -> None:
        """Store a value."""


T = TypeVar("T")


class _Step(NamedTuple):
    """One message's effect on its group, and its size in memory, bytes."""

    take: Callable[[Group], Iterator[ResultsBlock | Reply]]
    size: int = 0


@dataclass
class _Held:
    """A group, and the steps since its last checkpoint."""

    group: Group
    mark: bytes = b""
    steps: list[_Step] = field(default_factory=list)


class Worker:
    """Processes messages of any group; `samples` and `command` return messages to publish.

    `keep` must be called before each commit. `rejected` returns the dead letters since its last
    call, which belong into the same transaction. A message whose processing raises is rejected,
    too, and its group is restored from its checkpoint and the steps since. A damaged checkpoint
    becomes a dead letter, and its group starts without it.

    Parameters
    ----------
    catalogue
        All groups.
    rhythm
        Publishing intervals.
    topics
        Largest message.
    metrics
        Receives counts and results, if they are exported.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        rhythm: Rhythm,
        topics: TopicsConfig | None = None,
        metrics: WorkerMetrics | None = None,
    ) -> None:
        self._metrics = metrics
        self._catalogue = catalogue
        self._rhythm = rhythm
        self._decoder = Decoder(catalogue, topics)
        self._held: dict[str, _Held] = {}
        self._unkept: dict[str, Store] = {}
        self._own, self._turn = os.urandom(12), 0
        self._rejected: list[DeadLetter] = []
        self._tracebacks = Tracebacks()
        self._log = RejectionLog(time.monotonic)
        self._most_held = round((topics or TopicsConfig()).message_mb * 1e6)

    def samples(
        self, key: bytes | None, message: bytes, store: Store, sent: int | None = None
    ) -> list[bytes]:
        """Process a block of samples; ``sent`` is its Kafka timestamp, UTC ns, if known.

        Raises
        ------
        FleetError
            if the group's checkpoint is of a newer catalogue or format; nothing is changed.
        """

        def learn(block: SamplesBlock) -> _Step:
            return _Step(lambda group: group.take(block, sent), len(block.samples) * ROW_BYTES)

        return self._do(key, message, store, self._decoder.samples, learn)

    def command(self, key: bytes | None, message: bytes, store: Store) -> list[bytes]:
        """Execute a command of an operator.

        Raises
        ------
        FleetError
            as `samples`.
        """

        def do(command: Command) -> _Step:
            return _Step(lambda group: group.do(command), len(message))

        return self._do(key, message, store, self._decoder.command, do)

    def rejected(self) -> list[DeadLetter]:
        """Return the dead letters since the last call."""
        found, self._rejected = self._rejected, []
        if self._metrics is not None:
            self._metrics.note_rejected(len(found))
        return found

    def keep(self) -> None:
        """Write the checkpoints of the groups that had messages since the last call."""
        for name, store in self._unkept.items():
            held = self._held[name]
            if store.get_bytes(MARK) == held.mark:  # else it was rolled back
                store.set_bytes(MEMORY, held.group.to_bytes())
                held.steps = []
        self._unkept.clear()

    def _do(
        self,
        key: bytes | None,
        message: bytes,
        store: Store,
        decode: Callable[[bytes | None, bytes], T | Rejected],
        step_of: Callable[[T], _Step],
    ) -> list[bytes]:
        found = decode(key, message)
        why = found.reason if isinstance(found, Rejected) else ""
        out: list[bytes] = []
        name = (key or b"").decode("utf-8", "replace")
        if name not in self._catalogue.groups:
            self._reject(key, message, why)
            return out
        held = self._hold(name, store)
        if isinstance(found, Rejected):
            held.group.refuse()
            held.steps.append(_REFUSED)
        else:
            why, out = self._step(name, store, held, step_of(found))
        for failure in held.group.identification.failures.take_new():
            log_failure(failure)
        if why:
            self._reject(key, message, why)
        self._mark(name, held, store)
        if self._metrics is not None:
            self._metrics.note_group(name, held.group.number, held.group.counts)
        if len(held.steps) >= _MOST_STEPS or sum(s.size for s in held.steps) > self._most_held:
            store.set_bytes(MEMORY, held.group.to_bytes())
            held.steps = []
        return out

    def _step(self, name: str, store: Store, held: _Held, step: _Step) -> tuple[str, list[bytes]]:
        """Apply one step; return the reason, if the message was rejected, and the results."""
        before, out = held.group.counts[AHEAD], list[bytes]()
        held.steps.append(step)
        try:
            for one in step.take(held.group):
                out += _packed(held.group, one)
                if self._metrics is not None and isinstance(one, ResultsBlock):
                    self._metrics.note_results(one)
        except BlockError as error:
            held.group.refuse()
            return str(error), []
        except Exception as error:  # noqa: BLE001 - bulkhead: one message ends no worker
            why = self._tracebacks.note(error)
            held.group = self._before(name, store, held.steps[:-1])
            held.group.refuse()
            held.steps[-1] = _REFUSED
            return why, []
        ahead = held.group.counts[AHEAD] - before
        return (f"{ahead} samples are dated far off the group's clock" if ahead else ""), out

    def _before(self, name: str, store: Store, steps: list[_Step]) -> Group:
        """Rebuild a group bit-identically from its checkpoint and the steps since."""
        group = self._kept(name, store)
        for step in steps:
            try:
                for _ in step.take(group):
                    pass
            except BlockError:
                group.refuse()
        return group

    def _hold(self, name: str, store: Store) -> _Held:
        """Return the group in memory if the store has its mark, else restore its checkpoint."""
        held, mark = self._held.get(name), store.get_bytes(MARK)
        if held is not None and mark == held.mark:
            return held
        group = self._kept(name, store)
        if group.number or store.get_bytes(MEMORY) is not None:
            log.info("group taken over", group=name, block=group.number)
        else:
            log.info("group begun", group=name)
        return _Held(group)

    def _kept(self, name: str, store: Store) -> Group:
        group, packed = self._fresh(name), store.get_bytes(MEMORY)
        if packed is None:
            return group
        try:
            afresh = group.remember(packed)
        except DamagedState as error:
            why = f"state set aside, the group starts without it: {error}"
            self._rejected.append(DeadLetter.of_state(name, packed, why, self._most_held))
            self._log.note(name.encode(), why)
            group = self._fresh(name)
            group.counts[DAMAGED] += 1
            return group
        if afresh:
            log.warning("configured otherwise now, starts afresh", group=name, what=afresh)
        return group

    def _fresh(self, name: str) -> Group:
        return Group(self._catalogue.groups[name], self._catalogue.version, self._rhythm)

    def _mark(self, name: str, held: _Held, store: Store) -> None:
        self._turn += 1
        held.mark = self._own + self._turn.to_bytes(8, "big")
        self._unkept[name] = store
        store.set_bytes(MARK, held.mark)
        self._held[name] = held

    def _reject(self, key: bytes | None, message: bytes, why: str) -> None:
        self._rejected.append(DeadLetter.of(key, message, why))
        self._log.note(key, why)


_MOST_STEPS: Final = 1_000  # steps of a group kept between two commits


def _refuse(group: Group) -> Iterator[ResultsBlock | Reply]:
    group.refuse()
    return iter(())


_REFUSED: Final = _Step(_refuse)


def _packed(group: Group, one: ResultsBlock | Reply) -> list[bytes]:
    """Encode a message; if that fails, encode the results of each valve separately."""
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
