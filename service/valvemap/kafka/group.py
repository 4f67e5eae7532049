"""One group of valves: consumes blocks and commands, produces results and replies. Pure.

The output depends only on the input and its order: not on the batching of messages, the clock
or the machine.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.errors import BlockError, CommandRejected, DamagedState, FleetError
from valvemap.kafka.blocks import SamplesBlock, renumbered, some
from valvemap.kafka.catalogue import GroupPlan
from valvemap.kafka.commands import (
    ACTIONS,
    ESTIMATOR,
    NOTHING,
    QUESTIONS,
    Command,
    Reply,
    carry_out,
    read_reply,
    write_message,
)
from valvemap.kafka.group_clock import Ahead, plausible
from valvemap.kafka.memory import Memory, read_memory, write_memory
from valvemap.kafka.result_blocks import ResultsBlock
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import MOST_OF_A_REASON, Step
from valvemap.pipeline.results import Results
from valvemap.vocabulary.signals import OPTIONAL

REPEATED: Final = "repeated"  # blocks received before
MISSING: Final = "missing"  # blocks never received
BEGUN_ANEW: Final = "begun_anew"  # restarts of the block numbers
REFUSED: Final = "refused"  # messages that could not be decoded
AHEAD: Final = "ahead"  # samples dated far ahead of the group's clock
DAMAGED: Final = "damaged"  # states that were set aside
COUNTS: Final = (REPEATED, MISSING, BEGUN_ANEW, REFUSED, AHEAD, DAMAGED)
_RESULTS: Final = "results"
_MAPS: Final = "maps"
_NO_TABLE: Final = np.empty((0, 0))
_REPLIES: Final = 100  # replies kept of a group; a command is resent within seconds


@dataclass(frozen=True)
class Rhythm:
    """Publishing intervals in source time, ns; 0 publishes with every block."""

    results_ns: int = 1_000_000_000
    maps_ns: int = 60_000_000_000


class Group:
    """The pipeline of one group; its checkpoints restore it bit-identically.

    Parameters
    ----------
    plan
        Its valves.
    catalogue
        Version of the plan's catalogue.
    rhythm
        Publishing intervals of results, tables and surveys.
    """

    def __init__(self, plan: GroupPlan, catalogue: int, rhythm: Rhythm | None = None) -> None:
        self.plan = plan
        self._catalogue = catalogue
        self._rhythm = rhythm or Rhythm()
        alignment = Alignment(AlignmentSettings(), (OPTIONAL,) * len(plan.plans))  # done by collect
        self.identification = Identification(plan.plans, alignment)
        self.number = 0
        self.counts = dict.fromkeys(COUNTS, 0)
        self._due: dict[str, int] = {}
        self._ahead: Ahead = ()
        self._replies: dict[str, Reply] = {}
        self._numbers = {one.name: number for number, one in enumerate(plan.plans)}

    def take(self, block: SamplesBlock, sent: int | None = None) -> Iterator[ResultsBlock]:
        """Process a block; repeated blocks and samples far ahead of the clock are rejected.

        ``sent`` is the message's Kafka timestamp, UTC ns, if known.

        Raises
        ------
        BlockError
            if it has unknown valves, or all its samples are dated far ahead; no estimator changes.
        """
        samples = self._without_ahead(self._own(block), block.number, sent)
        newest = int(samples.samples.t.max(initial=0))
        if block.number <= self.number:
            if newest <= self._newest():
                self.counts[REPEATED] += 1
                return
            self.counts[BEGUN_ANEW] += 1
        elif self.number:
            self.counts[MISSING] += block.number - self.number - 1
        self.number = block.number
        if not len(samples):
            return
        self.identification.learn(samples)
        yield from self._results_due(newest)

    def do(self, command: Command) -> Iterator[ResultsBlock | Reply]:
        """Execute a command between two blocks; yield the changed results and the reply.

        A repeated command, known by its id, gets the first reply and is not executed again.
        """
        before = self._replies.get(command.id)
        if before is not None:
            yield before
            return
        reason = ""
        values: tuple[float | None, ...] = ()
        if command.valve not in self._numbers:
            reason = f"group {self.plan.name} has no valve {command.valve!r}"
        elif not self._knows(command):
            reason = f"{command.valve} has no estimator {command.estimator!r}"
        else:
            try:
                values = carry_out(command, self.identification)
            except CommandRejected as error:
                reason = str(error)
            except Exception as error:  # noqa: BLE001 - a bulkhead: other commands are done
                reason = f"{type(error).__name__}: {error}"[:MOST_OF_A_REASON]
        reply = Reply(command.id, self.plan.name, self.number, not reason, reason, values)
        if command.action not in QUESTIONS:
            self._note(reply)
            if not reason:
                for results in self.identification.results.of([self._numbers[command.valve]]):
                    yield self._block(_without_tables(results))
        yield reply

    def everything(self) -> Iterator[ResultsBlock]:
        """Yield results of all valves, with new tables and surveys."""
        self.identification.maps.refresh_all()
        for results in self.identification.results.of(range(len(self.plan.plans))):
            yield self._block(results)

    def alone(self, results: Results) -> Iterator[ResultsBlock]:
        """Yield the results of each of these valves again, as separate blocks."""
        for valve in results.valves.tolist():
            for one in self.identification.results.of([valve]):
                yield self._block(_without_tables(one))

    def stop(self, results: Results, error: Exception) -> ResultsBlock:
        """Stop a valve whose results cannot be encoded; return its results with quality Bad."""
        (valve,) = results.valves.tolist()
        self.identification.stop(valve, Step.PUBLICATION, error)
        return self._block(self.identification.results.unknown(valve))

    def _note(self, reply: Reply) -> None:
        self._replies[reply.id] = reply
        while len(self._replies) > _REPLIES:
            del self._replies[next(iter(self._replies))]

    def refuse(self) -> None:
        """Count a message that could not be decoded."""
        self.counts[REFUSED] += 1

    def to_bytes(self) -> bytes:
        """Return a checkpoint of the group."""
        own = self.identification
        return write_memory(
            Memory(
                catalogue=self._catalogue,
                number=self.number,
                due=self._due,
                counts=self.counts,
                columns=own.kept_columns.columns(),
                baselines=own.kept_columns.baselines(),
                ahead=self._ahead,
                replies=[write_message(reply).decode() for reply in self._replies.values()],
            )
        )

    def remember(self, packed: bytes) -> list[str]:
        """Restore a checkpoint; return ``<Valve>: <what>`` for each part that was reset.

        Raises
        ------
        DamagedState
            if the checkpoint is invalid; the group cannot be used then.
        FleetError
            if the checkpoint is of a newer format or catalogue, or of a different catalogue with
            the same version.
        """
        try:
            memory = read_memory(packed)
            self._check(memory)
            afresh = self.identification.remember(memory.columns, memory.baselines)
            replies = [read_reply(packed_reply.encode()) for packed_reply in memory.replies]
        except (DamagedState, BlockError, StateMismatchError) as error:
            raise DamagedState(f"group {self.plan.name}: {error}") from None
        except FleetError as error:
            raise FleetError(f"group {self.plan.name}: {error}") from None
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            why = f"{type(error).__name__}: {error}".splitlines()[0]
            raise DamagedState(f"group {self.plan.name}: its memory is unusable: {why}") from None
        self.number = memory.number
        self.counts.update(memory.counts)
        self._due = dict(memory.due)
        self._ahead = memory.ahead
        for reply in replies:
            self._note(reply)
        return sorted(f"{valve}: {key.partition(' ')[0]}" for key, valve in afresh)

    def _check(self, memory: Memory) -> None:
        if memory.catalogue > self._catalogue:
            raise FleetError(
                f"it was learnt under version {memory.catalogue} of the catalogue, this is version "
                f"{self._catalogue}: bring the worker's catalogue up to date"
            )
        known = {(kept.key, valve) for kept in memory.columns for valve in kept.valves}
        own = {
            (one.key, valve)
            for one in self.identification.kept_columns.columns()
            for valve in one.valves
        }
        if memory.catalogue == self._catalogue and known != own:
            raise FleetError(
                f"its valves are configured otherwise under the same version {self._catalogue} of "
                "the catalogue: raise catalogue.version"
            )

    def _own(self, block: SamplesBlock) -> ByValve:
        """Return the samples with the group's valve numbers."""
        if block.group != self.plan.name:
            raise BlockError(f"a block of group {block.group} under the key {self.plan.name}")
        names = [block.valves[member] for member in block.samples.segments.members]
        unknown = [name for name in names if name not in self._numbers]
        if unknown:
            raise BlockError(f"group {self.plan.name} has no valve {unknown[0]!r}")
        return renumbered(
            block.samples, np.array([self._numbers[name] for name in names], np.int64)
        )

    def _without_ahead(self, samples: ByValve, number: int, sent: int | None) -> ByValve:
        """Return the samples that are not dated far ahead of the group's clock."""
        t, newest = samples.samples.t, self._newest()
        taken, self._ahead = plausible(t, number, newest, sent, self._ahead)
        if taken.all():
            return samples
        self.counts[AHEAD] += int((~taken).sum())
        if not taken.any():
            raise BlockError(f"all samples are dated far off the group's clock, e.g. {t.max()} ns")
        return some(samples, taken)

    def _newest(self) -> int:
        (signals, *_) = self.identification.kept_columns.columns()
        return int(signals.arrays["newest_t"].max(initial=0))

    def _knows(self, command: Command) -> bool:
        plan = self.plan.plans[self._numbers[command.valve]]
        on, _ = ACTIONS.get(command.action, (NOTHING, 0))
        return on != ESTIMATOR or command.estimator in plan.estimators

    def _results_due(self, newest: int) -> Iterator[ResultsBlock]:
        if not self._is_due(_RESULTS, newest, self._rhythm.results_ns):
            return
        with_tables = self._is_due(_MAPS, newest, self._rhythm.maps_ns)
        if with_tables:
            self.identification.maps.refresh_all()
        for results in self.identification.results.of(range(len(self.plan.plans))):
            yield self._block(results if with_tables else _without_tables(results))

    def _is_due(self, name: str, newest: int, interval_ns: int) -> bool:
        """Whether source time has reached the next due time, or has stepped back."""
        due = self._due.get(name, 0)
        if due - interval_ns <= newest < due:
            return False
        self._due[name] = (newest // interval_ns + 1) * interval_ns if interval_ns else 0
        return True

    def _block(self, results: Results) -> ResultsBlock:
        names = tuple(plan.name for plan in self.plan.plans)
        return ResultsBlock(self.plan.name, self.number, names, results)


def _without_tables(results: Results) -> Results:
    """Return the results without tables and surveys."""
    M = len(results.valves)
    return replace(
        results,
        inverse=replace(results.inverse, map_U=[_NO_TABLE] * M),
        estimators={
            name: replace(found, survey=[None] * M) for name, found in results.estimators.items()
        },
    )
