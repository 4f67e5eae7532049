"""Decodes and validates messages: returns a value, or the reason of the rejection.

Workers, results server, mirror and status all decode messages with `Decoder`. Limits follow from
the configuration and are checked before decompression.
"""

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeVar

import structlog

from valvemap.errors import BlockError, FleetError
from valvemap.kafka.blocks import SamplesBlock, read_samples
from valvemap.kafka.catalogue import Catalogue
from valvemap.kafka.commands import Command, Reply, is_reply, read_command, read_reply
from valvemap.kafka.envelope import Limits, check
from valvemap.kafka.memory import Memory, read_memory
from valvemap.kafka.result_blocks import ResultsBlock, read_results
from valvemap.kafka.result_checks import check_results
from valvemap.kafka.settings import TopicsConfig
from valvemap.pipeline.results import ValveDescription
from valvemap.pipeline.valve_descriptions import descriptions

ROW_BYTES: Final = 8 * 6 + 1 + 4  # bytes of an uncompressed sample in a block
SHARE: Final = 0.5  # maximum size of a block of samples before compression, per largest message
_MOST_TRACEBACKS: Final = 100  # locations remembered, so that each traceback is logged once

T = TypeVar("T")
log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Rejected:
    """A rejected message, with the reason in one line."""

    reason: str


class Decoder:
    """Decodes messages of the groups of a catalogue.

    Parameters
    ----------
    catalogue
        All groups.
    topics
        Largest message.
    """

    def __init__(self, catalogue: Catalogue, topics: TopicsConfig | None = None) -> None:
        self._catalogue = catalogue
        self._tracebacks = Tracebacks()
        largest = round((topics or TopicsConfig()).message_mb * 1e6)
        valves = max((len(one.plans) for one in catalogue.groups.values()), default=0)
        # `collect` limits blocks to SHARE of a message before compression.
        self._samples = Limits(largest, most_rows(largest), largest, valves)
        # Results are smaller than the group's checkpoint, which must fit into a message.
        self._results = Limits(largest, valves, largest, valves)

    def samples(self, key: bytes | None, message: bytes) -> SamplesBlock | Rejected:
        """Decode a block of samples; its group and valves must be in the catalogue."""

        def read() -> SamplesBlock:
            group = self._group(key)
            check(message, self._samples)
            block = read_samples(message)
            _check_group(block.group, group)
            if block.catalogue > self._catalogue.version:
                raise BlockError(
                    f"its samples come under version {block.catalogue} of the catalogue, this is "
                    f"version {self._catalogue.version}: bring the worker's catalogue up to date"
                )
            valves = self._described[group]
            members = block.samples.segments.members.tolist()
            unknown = [block.valves[m] for m in members if block.valves[m] not in valves]
            if unknown:
                raise BlockError(f"group {group} has no valve {unknown[0]!r:.100}")
            return block

        return self._read(read)

    def command(self, key: bytes | None, message: bytes) -> Command | Rejected:
        """Decode a command; its group must be in the catalogue."""

        def read() -> Command:
            group = self._group(key)
            command = read_command(message)
            _check_group(command.group, group)
            return command

        return self._read(read)

    def published(self, key: bytes | None, message: bytes) -> ResultsBlock | Reply | Rejected:
        """Decode results or a reply; the group must be in the catalogue."""

        def read() -> ResultsBlock | Reply:
            group = self._group(key)
            if is_reply(message):
                reply = read_reply(message)
                _check_group(reply.group, group)
                return reply
            check(message, self._results)
            block = read_results(message)
            _check_group(block.group, group)
            check_results(block, self._described[group])
            return block

        return self._read(read)

    def has_group(self, key: bytes | None) -> bool:
        """Whether the catalogue has the group of a message's key."""
        return (key or b"").decode("utf-8", "replace") in self._catalogue.groups

    def memory(self, packed: bytes) -> Memory | Rejected:
        """Decode a group's checkpoint."""
        return self._read(lambda: read_memory(packed))

    def _group(self, key: bytes | None) -> str:
        name = (key or b"").decode("utf-8", "replace")
        if name not in self._catalogue.groups:
            raise BlockError(f"no group {name!r:.100} in the catalogue")
        return name

    @cached_property
    def _described(self) -> Mapping[str, Mapping[str, ValveDescription]]:
        return {
            name: {one.name: one for one in descriptions(group.plans)}
            for name, group in self._catalogue.groups.items()
        }

    def _read(self, read: Callable[[], T]) -> T | Rejected:
        try:
            return read()
        except FleetError as error:
            return Rejected(str(error))
        except Exception as error:  # noqa: BLE001 - bulkhead: one message ends no reader
            return Rejected(self._tracebacks.note(error))


class Tracebacks:
    """Logs the traceback of unexpected exceptions, once for each location."""

    def __init__(self) -> None:
        self._known: set[tuple[str, int, str]] = set()

    def note(self, error: Exception) -> str:
        """Log the traceback if its location is new; return the exception as one line."""
        *_, last = traceback.extract_tb(error.__traceback__) or [None]
        kind = type(error).__name__
        place = ("", 0, kind) if last is None else (last.filename, last.lineno or 0, kind)
        if place not in self._known and len(self._known) < _MOST_TRACEBACKS:
            self._known.add(place)
            log.error("unexpected exception, the message is rejected", exc_info=error)
        said = (str(error).splitlines() or [""])[0]
        return f"unexpected {kind}: {said:.200}"


def most_rows(largest: int) -> int:
    """Maximum number of rows in a block of samples, from the largest message, bytes.

    >>> most_rows(16_000_000)
    150943
    """
    return max(1, int(largest * SHARE / ROW_BYTES))


def _check_group(named: str, key: str) -> None:
    if named != key:
        raise BlockError(f"a message of group {named!r:.100} under the key {key}")
