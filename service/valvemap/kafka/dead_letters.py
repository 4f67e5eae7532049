"""Messages that were rejected, as they go to their own topic: the reason, and where the whole lies.

The payload's beginning is kept, and its length; the whole message stays at its place in its topic
for as long as that keeps it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import structlog
from confluent_kafka import KafkaError, KafkaException, Producer

from valvemap.kafka.broker import client_settings, reason, silent
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.topics import REJECTED, topic_name

MOST_PAYLOAD: Final = 65_536  # bytes; enough to inspect a message, and the whole of a command
_MOST_KEY: Final = 1_024  # bytes; a group's name is shorter
_MOST_REASON: Final = 1_000  # characters
_LINES_PER_S: Final = 0.1  # of the log: a flood of messages shall not flood it, too
_LINES_AT_ONCE: Final = 20
_QUEUED_KB: Final = 16_000  # that wait for the broker; further dead letters are counted as lost

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Place:
    """Where a message lies."""

    topic: str
    partition: int
    offset: int


@dataclass(frozen=True)
class DeadLetter:
    """A message that was rejected; ``payload`` is its beginning, ``size`` all its bytes."""

    key: bytes
    payload: bytes
    size: int
    reason: str

    @classmethod
    def of(cls, key: bytes | None, message: bytes, why: str) -> "DeadLetter":
        """Make the dead letter of a message.

        >>> len(DeadLetter.of(b"north.0", bytes(100_000), "too large").payload)
        65536
        """
        short = why.encode("utf-8", "replace").decode()[:_MOST_REASON]
        return cls((key or b"")[:_MOST_KEY], message[:MOST_PAYLOAD], len(message), short)

    def headers(self, place: Place | None) -> list[tuple[str, bytes]]:
        """Kafka's headers: topic, partition, offset, size and reason."""
        said: dict[str, object] = {"size": self.size, "reason": self.reason}
        if place is not None:
            said = {
                "topic": place.topic,
                "partition": place.partition,
                "offset": place.offset,
            } | said
        return [(name, str(value).encode()) for name, value in said.items()]


class RejectionLog:
    """A warning for each rejected message, but no more than a few at once; all are counted.

    ``clock`` gives monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._room, self._at = float(_LINES_AT_ONCE), clock()
        self.count = 0
        self._unsaid = 0

    def note(self, key: bytes | None, why: str) -> None:
        """Count it, and log it, if there is room."""
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
    """Sends dead letters outside of a transaction: for readers that commit nothing."""

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
        """Send it; never waits."""
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
