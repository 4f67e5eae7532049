"""Kafka clients of `serve`: a consumer of results, a producer of commands."""

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import structlog
from confluent_kafka import (
    TIMESTAMP_NOT_AVAILABLE,
    Consumer,
    KafkaError,
    KafkaException,
    Producer,
    TopicPartition,
)

from valvemap.errors import FleetError
from valvemap.kafka.blocks import SamplesBlock
from valvemap.kafka.broker import client_settings, reason, silent, speaking_to
from valvemap.kafka.commands import Command, Reply, write_message
from valvemap.kafka.dead_letters import DeadLetter, DeadLetterPost, Place, RejectionLog
from valvemap.kafka.decoding import Decoder, Rejected
from valvemap.kafka.rejections import Rejection
from valvemap.kafka.result_blocks import ResultsBlock
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.state_topic import memories
from valvemap.kafka.topics import (
    COMMANDS,
    REJECTED,
    RESULTS,
    SAMPLES,
    STATE,
    check_partitions,
    topic_name,
)

_AT_ONCE: Final = 200  # messages of one poll
_WAIT_S: Final = 0.05
_SAID_AGAIN_S: Final = 60.0

log = structlog.get_logger(__name__)


@dataclass
class Heard:
    """Messages of one poll: new results, results older than the start, replies, samples, rejected.

    ``rejected`` are the site's dead letters of all workers, and the messages rejected here.
    """

    results: list[ResultsBlock] = field(default_factory=list)
    earlier: list[ResultsBlock] = field(default_factory=list)
    replies: list[Reply] = field(default_factory=list)
    samples: list[SamplesBlock] = field(default_factory=list)
    rejected: list[Rejection] = field(default_factory=list)


class ResultsReader:
    """Consumes the results of the given groups; its methods block, and are not thread-safe.

    Parameters
    ----------
    config
        Broker and topics.
    name
        Name of the consumer group, for committed offsets.
    groups
        Names of the groups.
    decoder
        Decodes the messages.
    keeps_history
        Whether to resume at the last `commit` and to read the samples, too.
    """

    def __init__(
        self,
        config: FleetConfig,
        name: str,
        groups: Collection[str],
        decoder: Decoder,
        *,
        keeps_history: bool,
    ) -> None:
        self._config = config
        self._groups = frozenset(name.encode() for name in groups)
        kinds = (RESULTS, SAMPLES, REJECTED) if keeps_history else (RESULTS, REJECTED)
        self._topics = {topic_name(config.topics, kind): kind for kind in kinds}
        self._keeps_history = keeps_history
        largest = round(config.topics.message_mb * 1e6)
        self._consumer = Consumer(
            {
                **client_settings(config.broker),
                "group.id": f"{config.topics.prefix}.{name}",
                "enable.auto.commit": False,
                "auto.offset.reset": "earliest",
                "fetch.max.bytes": 4 * largest,
                "receive.message.max.bytes": 8 * largest,
                "error_cb": self._noted,
            },
            logger=silent(),
        )
        self._decoder = decoder
        self._dead_letters = DeadLetterPost(config)
        self._log = RejectionLog(time.monotonic)
        self._ends: dict[tuple[str, int], int] = {}
        self._away = False
        self._said = -_SAID_AGAIN_S

    def begin(self) -> Mapping[str, bytes]:
        """Assign the start offsets; return the newest checkpoint of each group.

        A checkpoint is older than all messages that `read` returns as results.

        Raises
        ------
        FleetError
        """
        config = self._config
        check_partitions(config, RESULTS, COMMANDS, STATE, SAMPLES, REJECTED)
        with speaking_to(config.broker):
            starts = [self._start(place) for place in self._places()]
            names = {name.decode() for name in self._groups}
            kept = {n: one.packed for n, one in memories(self._consumer, config, names)}
            self._consumer.assign(starts)
        return kept

    def read(self) -> Heard:
        """Poll with a short timeout.

        Raises
        ------
        FleetError
        """
        heard = Heard()
        for message in self._consumer.consume(_AT_ONCE, _WAIT_S):
            error = message.error()
            if error is not None:
                if error.retriable() or error.name() in _PASSING:
                    continue
                raise FleetError(f"{message.topic()}: {reason(KafkaException(error))}")
            if self._away:
                self._away = False
                log.info("broker is back")
            if self._topics[message.topic()] == REJECTED:
                self._take_dead_letter(message, heard)
            elif message.key() in self._groups:
                self._sort(message, heard)
        return heard

    def commit(self) -> None:
        """Commit the offsets of all messages read."""
        places = [
            place
            for place in self._consumer.position(self._consumer.assignment())
            if place.offset >= 0
        ]
        if places:
            self._consumer.commit(offsets=places, asynchronous=True)

    def close(self) -> None:
        """Close the consumer."""
        self._consumer.close()
        self._dead_letters.close()

    def _places(self) -> list[TopicPartition]:
        partitions = range(self._config.topics.partitions)
        return [TopicPartition(topic, p) for topic in self._topics for p in partitions]

    def _start(self, place: TopicPartition) -> TopicPartition:
        """Return the start offset: the end or, with history, the committed offset.

        Of dead letters: the first one that the alarm still counts.
        """
        timeout_s = self._config.broker.timeout_s
        low, high = self._consumer.get_watermark_offsets(place, timeout=timeout_s)
        if self._topics[place.topic] == REJECTED:
            since_ms = round((time.time() - self._config.serve.rejected_quiet_s) * 1e3)
            asked = TopicPartition(place.topic, place.partition, since_ms)
            (found,) = self._consumer.offsets_for_times([asked], timeout=timeout_s)
            at = found.offset if found.offset >= 0 else high
            return TopicPartition(place.topic, place.partition, at)
        self._ends[place.topic, place.partition] = high
        if not self._keeps_history:
            return TopicPartition(place.topic, place.partition, high)
        (before,) = self._consumer.committed([place], timeout=timeout_s)
        at = high if before.offset < 0 else max(before.offset, low)
        return TopicPartition(place.topic, place.partition, at)

    def _sort(self, message: Any, heard: Heard) -> None:  # noqa: ANN401 - Kafka's
        packed, key, topic = message.value() or b"", message.key(), message.topic()
        new = message.offset() >= self._ends[topic, message.partition()]
        if self._topics[topic] == SAMPLES:
            samples = self._decoder.samples(key, packed)
            if not isinstance(samples, Rejected):  # the worker sends the dead letter
                heard.samples.append(samples)
            return
        match self._decoder.published(key, packed):
            case Rejected(why):
                self._log.note(key, why)
                heard.rejected.append(Rejection.of(key, why))
                place = Place(topic, message.partition(), message.offset())
                self._dead_letters.send(DeadLetter.of(key, packed, why), place)
            case ResultsBlock() as block:
                (heard.results if new else heard.earlier).append(block)
            case Reply() as reply:
                heard.replies.append(reply)

    def _take_dead_letter(self, message: Any, heard: Heard) -> None:  # noqa: ANN401 - Kafka's
        key, (kind, sent_ms) = message.key(), message.timestamp()
        if key not in self._groups and self._decoder.has_group(key):
            return  # of another site
        t = 0 if kind == TIMESTAMP_NOT_AVAILABLE else sent_ms * 1_000_000
        found = Rejection.from_headers(key, message.headers(), t)
        if self._topics.get(found.topic) != RESULTS:  # those were counted where they were rejected
            heard.rejected.append(found)

    def _noted(self, error: KafkaError) -> None:
        if error.name() == "_ALL_BROKERS_DOWN":
            self._away = True
            if time.monotonic() - self._said >= _SAID_AGAIN_S:
                self._said = time.monotonic()
                addresses = ",".join(self._config.broker.addresses)
                log.warning("broker cannot be reached, waiting for it", addresses=addresses)


_PASSING: Final = {"_ALL_BROKERS_DOWN", "_TRANSPORT", "_TIMED_OUT", "_RESOLVE", "_PARTITION_EOF"}


class CommandPost:
    """Implements :class:`valvemap.kafka.operating.Post`."""

    def __init__(self, config: FleetConfig) -> None:
        self._topic = topic_name(config.topics, COMMANDS)
        self._producer = Producer(
            {
                **client_settings(config.broker),
                "enable.idempotence": True,
                "partitioner": "murmur2_random",
                "message.timeout.ms": max(1_000, round(config.serve.answer_s * 1e3)),
                "linger.ms": 0,
            },
            logger=silent(),
        )

    def send(self, command: Command, refused: Callable[[str], None]) -> None:
        """Send a command."""

        def delivered(error: KafkaError | None, _message: Any) -> None:  # noqa: ANN401
            if error is not None:
                refused(f"not sent: {reason(KafkaException(error))}")

        self._producer.produce(
            self._topic, write_message(command), command.group.encode(), on_delivery=delivered
        )
        self._producer.poll(0)

    def tend(self) -> None:
        """Process delivery reports; to be called regularly."""
        self._producer.poll(0)

    def close(self) -> None:
        """Flush the queue, for at most 1 s."""
        self._producer.flush(1.0)
