"""Dead letters: rejected messages, and damaged states, with the reason and their offset.

The dead letter of a message holds the beginning of the payload and its length. The whole message
stays in its topic until its retention time ends. The dead letter of a state holds all of it that a
message can: the state topic does not retain it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import structlog
from confluent_kafka import KafkaError, KafkaException, Producer

from valvemap.kafka.broker import client_settings, reason, silent
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.topics import REJECTED, topic_name

MOST_PAYLOAD: Final = 65_536  # bytes; enough to inspect a message, and all of a command
MESSAGE: Final = "message"
STATE: Final = "state"
_ROOM_FOR_HEADERS: Final = 16_384  # bytes; of a message, for key, headers and framing
_MOST_KEY: Final = 1_024  # bytes; longer than any group name
_MOST_REASON: Final = 1_000  # characters
_LINES_PER_S: Final = 0.1  # log lines a second, so that rejected messages cannot flood the log
_LINES_AT_ONCE: Final = 20
_QUEUED_KB: Final = 16_000  # kB in the producer's queue; further dead letters are counted as lost

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Place:
    """Topic, partition and offset of a message."""

    topic: str
    partition: int
    offset: int


@dataclass(frozen=True)
class DeadLetter:
    """A rejected message; ``payload`` is its beginning, ``size`` its length in bytes.

    ``content`` is MESSAGE or STATE. The place of a state is the message before which it was read.
    """

    key: bytes
    payload: bytes
    size: int
    reason: str
    content: str = MESSAGE

    @classmethod
    def of(cls, key: bytes | None, message: bytes, why: str) -> "DeadLetter":
        """Return the dead letter of a message.

        >>> len(DeadLetter.of(b"north.0", bytes(100_000), "too large").payload)
        65536
        """
        short = why.encode("utf-8", "replace").decode()[:_MOST_REASON]
        return cls((key or b"")[:_MOST_KEY], message[:MOST_PAYLOAD], len(message), short)

    @classmethod
    def of_state(cls, group: str, packed: bytes, why: str, most: int) -> "DeadLetter":
        """Return the dead letter of a damaged state; ``most`` is the largest message, bytes."""
        short = cls.of(group.encode(), packed, why)
        return replace(short, payload=packed[: most - _ROOM_FOR_HEADERS], content=STATE)

    def headers(self, place: Place | None) -> list[tuple[str, bytes]]:
        """Kafka headers: topic, partition, offset, content, size and reason."""
        said: dict[str, object] = {
            "content": self.content,
            "size": self.size,
            "reason": self.reason,
        }
        if place is not None:
            said = {
                "topic": place.topic,
                "partition": place.partition,
                "offset": place.offset,
            } | said
        return [(name, str(value).encode()) for name, value in said.items()]


class RejectionLog:
    """Logs rejected messages at a limited rate; all are counted.

    ``clock`` returns monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._room, self._at = float(_LINES_AT_ONCE), clock()
        self.count = 0
        self._unsaid = 0

    def note(self, key: bytes | None, why: str) -> None:
        """Count a rejection, and log it within the rate limit."""
        self.count += 1
        now = self._clock()
        self._room = min(_LINES_AT_ONCE, self._room + (now - self._at) * _LINES_PER_S)
        self._at = now
        if self._room < 1.0:
            self._unsaid += 1
            return
        self._room -= 1.0
        more = {"not_logged": self._unsaid} if self._unsaid else {}
        self._unsaid = 0
        group = (key or b"").decode("utf-8", "replace")[:100]
        log.warning("message rejected", group=group, reason=why, rejected=self.count, **more)


class DeadLetterPost:
    """Sends dead letters outside of transactions, for readers without a transactional producer."""

    def __init__(self, config: FleetConfig) -> None:
        self._topic = topic_name(config.topics, REJECTED)
        self._producer = Producer(
            {
                **client_settings(config.broker),
                "message.timeout.ms": max(1_000, round(config.broker.timeout_s * 1e3)),
                "queue.buffering.max.kbytes": _QUEUED_KB,
            },
            logger=silent(),
        )
        self.lost = 0

    def send(self, letter: DeadLetter, place: Place) -> None:
        """Queue a dead letter; never blocks."""
        try:
            self._producer.produce(
                self._topic,
                letter.payload,
                letter.key,
                headers=letter.headers(place),
                on_delivery=self._delivered,
            )
        except BufferError:
            self._note_lost("the queue is full")
        self._producer.poll(0)

    def close(self) -> None:
        """Flush the queue, for at most 1 s."""
        self._producer.flush(1.0)

    def _delivered(self, error: KafkaError | None, _message: Any) -> None:  # noqa: ANN401
        if error is not None:
            self._note_lost(reason(KafkaException(error)))

    def _note_lost(self, why: str) -> None:
        self.lost += 1
        if self.lost & (self.lost - 1) == 0:  # at 1, 2, 4, 8 …
            log.warning("dead letters lost", lost=self.lost, reason=why)
