"""One group of valves: blocks and commands in, results and replies out. Pure.

What comes out follows from what went in and its order alone: not from how it was cut into
messages per call, not from the clock, not from the machine.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.errors import BlockError, CommandRejected, FleetError
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
from valvemap.pipeline.alignment import Alignment, AlignmentSettings, ByValve
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import MOST_OF_A_REASON, Step
from valvemap.pipeline.ports import Results

REPEATED: Final = "repeated"  # blocks that had come before
MISSING: Final = "missing"  # blocks that never came
BEGUN_ANEW: Final = "begun_anew"  # times that the numbers began anew
REFUSED: Final = "refused"  # messages that could not be read
AHEAD: Final = "ahead"  # samples that were dated far ahead of the group's clock
COUNTS: Final = (REPEATED, MISSING, BEGUN_ANEW, REFUSED, AHEAD)
_RESULTS: Final = "results"
_MAPS: Final = "maps"
_NO_TABLE: Final = np.empty((0, 0))
_REPLIES: Final = 100  # kept of a group: a command that is sent twice is so within seconds


@dataclass(frozen=True)
class Rhythm:
    """How often things are published, in source time, ns; 0 is with every block."""

    results_ns: int = 1_000_000_000
    maps_ns: int = 60_000_000_000


class Group:
    """The pipeline of one group; what it remembers can be taken over to the bit.

    Parameters
    ----------
    plan
        Its valves.
    catalogue
        Version of the catalogue that the plan is from.
    rhythm
        When results, tables and surveys are due.
    """

    def __init__(self, plan: GroupPlan, catalogue: int, rhythm: Rhythm | None = None) -> None:
        self.plan = plan
        self._catalogue = catalogue
        self._rhythm = rhythm or Rhythm()
        alignment = Alignment(AlignmentSettings(), (True,) * len(plan.plans))  # collect has done it
        self.identification = Identification(plan.plans, alignment)
        self.number = 0
        self.counts = dict.fromkeys(COUNTS, 0)
        self._due: dict[str, int] = {}
        self._ahead: Ahead = ()
        self._replies: dict[str, Reply] = {}
        self._numbers = {one.name: number for number, one in enumerate(plan.plans)}

    def take(self, block: SamplesBlock, sent: int | None = None) -> Iterator[ResultsBlock]:
        """Learn from a block; repeated blocks and samples far off the clock are rejected.

        ``sent`` is the message's time in Kafka, UTC ns, if it is known.

        Raises
        ------
        BlockError
            if it is of other valves, or all of it is dated far ahead; nothing is learnt then.
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
        """Do what is asked for, between two blocks; the results show it at once.

        A command that comes again, by its id, is answered as before, and not done again.
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
                for results in self.identification.results([self._numbers[command.valve]]):
                    yield self._block(_without_tables(results))
        yield reply

    def everything(self) -> Iterator[ResultsBlock]:
        """All that is known, tables and surveys made anew."""
        self.identification.refresh_all_maps()
        for results in self.identification.results(range(len(self.plan.plans))):
            yield self._block(results)

    def alone(self, results: Results) -> Iterator[ResultsBlock]:
        """Make the results of each of these valves again, a block for each."""
        for valve in results.valves.tolist():
            for one in self.identification.results([valve]):
                yield self._block(_without_tables(one))

    def stop(self, results: Results, error: Exception) -> ResultsBlock:
        """Stop the one valve whose results cannot be packed; return Bad results of it."""
        (valve,) = results.valves.tolist()
        self.identification.stop(valve, Step.PUBLICATION, error)
        return self._block(self.identification.unknown(valve))

    def _note(self, reply: Reply) -> None:
        self._replies[reply.id] = reply
        while len(self._replies) > _REPLIES:
            del self._replies[next(iter(self._replies))]

    def refuse(self) -> None:
        """Count a message that could not be read."""
        self.counts[REFUSED] += 1

    def to_bytes(self) -> bytes:
        """All that is remembered."""
        own = self.identification
        return write_memory(
            Memory(
                catalogue=self._catalogue,
                number=self.number,
                due=self._due,
                counts=self.counts,
                columns=own.columns(),
                baselines=own.baselines(),
                ahead=self._ahead,
                replies=[write_message(reply).decode() for reply in self._replies.values()],
            )
        )

    def remember(self, packed: bytes) -> list[str]:
        """Go on from what is remembered; return ``<Valve>: <what>`` for what starts afresh.

        Raises
        ------
        FleetError
            if it is no memory, of a newer catalogue, or of another catalogue of this version.
        """
        try:
            memory = read_memory(packed)
            self._check(memory)
            afresh = self.identification.remember(memory.columns, memory.baselines)
        except (FleetError, StateMismatchError) as error:
            raise FleetError(f"group {self.plan.name}: {error}") from None
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            why = f"{type(error).__name__}: {error}".splitlines()[0]
            raise FleetError(f"group {self.plan.name}: its memory cannot be used: {why}") from None
        self.number = memory.number
        self.counts.update(memory.counts)
        self._due = dict(memory.due)
        self._ahead = memory.ahead
        for packed_reply in memory.replies:
            self._note(read_reply(packed_reply.encode()))
        return sorted(f"{valve}: {key.partition(' ')[0]}" for key, valve in afresh)

    def _check(self, memory: Memory) -> None:
        if memory.catalogue > self._catalogue:
            raise FleetError(
                f"it was learnt under version {memory.catalogue} of the catalogue, this is version "
                f"{self._catalogue}: bring the worker's catalogue up to date"
            )
        known = {(kept.key, valve) for kept in memory.columns for valve in kept.valves}
        own = {(one.key, valve) for one in self.identification.columns() for valve in one.valves}
        if memory.catalogue == self._catalogue and known != own:
            raise FleetError(
                f"its valves are configured otherwise under the same version {self._catalogue} of "
                "the catalogue: raise catalogue.version"
            )

    def _own(self, block: SamplesBlock) -> ByValve:
        """The samples, under our numbers of the valves."""
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
        """The samples that are not dated far ahead of the group's clock."""
        t, newest = samples.samples.t, self._newest()
        taken, self._ahead = plausible(t, number, newest, sent, self._ahead)
        if taken.all():
            return samples
        self.counts[AHEAD] += int((~taken).sum())
        if not taken.any():
            raise BlockError(f"all samples are dated far off the group's clock, e.g. {t.max()} ns")
        return some(samples, taken)

    def _newest(self) -> int:
        (signals, *_) = self.identification.columns()
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
            self.identification.refresh_all_maps()
        for results in self.identification.results(range(len(self.plan.plans))):
            yield self._block(results if with_tables else _without_tables(results))

    def _is_due(self, name: str, newest: int, interval_ns: int) -> bool:
        """Whether source time has come to the next turn, or stepped back from the last one."""
        due = self._due.get(name, 0)
        if due - interval_ns <= newest < due:
            return False
        self._due[name] = (newest // interval_ns + 1) * interval_ns if interval_ns else 0
        return True

    def _block(self, results: Results) -> ResultsBlock:
        names = tuple(plan.name for plan in self.plan.plans)
        return ResultsBlock(self.plan.name, self.number, names, results)


def _without_tables(results: Results) -> Results:
    """The same without what is no newer than before."""
    M = len(results.valves)
    return replace(
        results,
        inverse=replace(results.inverse, map_U=[_NO_TABLE] * M),
        estimators={
            name: replace(found, survey=[None] * M) for name, found in results.estimators.items()
        },
    )
