"""Sends the spool to the broker in a separate thread: in order, until acknowledged."""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import structlog
from confluent_kafka import KafkaError, KafkaException, Producer

from valvemap.errors import BrokerAway, FleetError
from valvemap.kafka.broker import client_settings, silent, speaking_to
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.spool import Spool
from valvemap.kafka.topics import SAMPLES, check_partitions, topic_name
from valvemap.runtime.backoff import backoff

_POLL_S: Final = 0.02
_UNDER_WAY: Final = 16_000_000  # bytes in flight: about one second
_LOOK_S: Final = 60.0  # s; interval of checks of the topic
_FAREWELL_S: Final = 5.0  # s; timeout for messages in flight at the end
SAID_AGAIN_S: Final = 60.0

log = structlog.get_logger(__name__)


class Sender(threading.Thread):
    """Sends blocks from a spool; deletes each once the brokers have acknowledged it.

    A block is sent to the partition of its group, in order. The producer is idempotent and retries
    without limit. If it must be replaced, sending resumes at the oldest unacknowledged block.

    Parameters
    ----------
    config
        Broker and topics.
    spool
        Queue of blocks.
    on_hopeless
        Called once if the topic does not match the configuration at the start.

    Attributes
    ----------
    hopeless : FleetError or None
        Permanent error that stopped the thread.
    """

    def __init__(self, config: FleetConfig, spool: Spool, on_hopeless: Callable[[], Any]) -> None:
        super().__init__(name="sender", daemon=True)
        self._config = config
        self._spool = spool
        self._topic = topic_name(config.topics, SAMPLES)
        self._on_hopeless = on_hopeless
        self.hopeless: FleetError | None = None
        self._found = False  # whether the topic has passed the check
        self._ended = threading.Event()
        self._sent: list[int] = []
        self._under_way: dict[int, int] = {}  # bytes by block id
        self._refused: KafkaError | None = None
        self._away = False
        self._said = -SAID_AGAIN_S

    @property
    def is_away(self) -> bool:
        """Whether the brokers cannot be reached."""
        return self._away

    @property
    def in_flight_bytes(self) -> int:
        """Size of the blocks sent and not acknowledged."""
        return sum(list(self._under_way.values()))

    def run(self) -> None:
        """Send until `stop` is called."""
        pauses = backoff()
        while not self._ended.is_set():
            try:
                self._send()
            except (FleetError, KafkaException) as error:
                if isinstance(error, BrokerAway):
                    self._say_away()
                elif not self._found and isinstance(error, FleetError):
                    self.hopeless = error
                    self._on_hopeless()
                    return
                else:
                    self._say("samples cannot be sent, they are kept on disk", reason=str(error))
                self._ended.wait(next(pauses))

    def stop(self) -> None:
        """Wait up to 10 s for messages in flight; the rest stays on disk."""
        self._ended.set()
        if self.is_alive():
            self.join(2.0 * _FAREWELL_S)

    def _send(self) -> None:
        """Send with one producer until it fails."""
        check_partitions(self._config, SAMPLES)
        self._found = True
        producer = self._producer()
        self._sent, self._under_way, self._refused = [], {}, None
        self._spool.take_again()
        try:
            self._send_with(producer)
        finally:
            producer.purge()
            producer.poll(0)
            self._note_sent()

    def _send_with(self, producer: Producer) -> None:
        look_at = time.monotonic() + _LOOK_S
        while not self._ended.is_set():
            room = _UNDER_WAY - sum(self._under_way.values())
            for one in self._spool.take(room) if room > 0 else ():
                self._under_way[one.id] = len(one.data)
                noted = partial(self._delivered, one.id)
                producer.produce(self._topic, one.data, one.group.encode(), on_delivery=noted)
            producer.poll(_POLL_S)
            self._note_sent()
            if self._refused is not None:
                with speaking_to(self._config.broker):
                    raise KafkaException(self._refused)
            if time.monotonic() > look_at and not self._away:
                check_partitions(self._config, SAMPLES)
                look_at = time.monotonic() + _LOOK_S
        producer.flush(_FAREWELL_S)

    def _producer(self) -> Producer:
        largest = round(self._config.topics.message_mb * 1e6)
        said: dict[str, Any] = {
            **client_settings(self._config.broker),
            "enable.idempotence": True,  # in order, exactly once
            "partitioner": "murmur2_random",  # default of the Java client
            "compression.type": "none",  # blocks are compressed
            "message.max.bytes": largest,
            "message.timeout.ms": 0,  # retry without limit
            "linger.ms": 5,
            "error_cb": self._noted,
        }
        return Producer(said, logger=silent())

    def _delivered(self, number: int, error: KafkaError | None, _message: Any) -> None:  # noqa: ANN401
        self._under_way.pop(number, None)
        if error is None:
            self._sent.append(number)
        elif error.name() != "_PURGE_QUEUE" and error.name() != "_PURGE_INFLIGHT":
            self._refused = self._refused or error

    def _note_sent(self) -> None:
        if not self._sent:
            return
        if self._away:
            self._away = False
            log.info("broker is back", waiting=self._spool.blocks)
        self._spool.note_sent(self._sent)
        self._sent = []

    def _noted(self, error: KafkaError) -> None:
        if error.name() == "_ALL_BROKERS_DOWN":
            self._say_away()
        elif error.fatal():
            self._refused = self._refused or error

    def _say_away(self) -> None:
        self._away = True
        addresses = ",".join(self._config.broker.addresses)
        self._say("broker cannot be reached, samples are kept on disk", addresses=addresses)

    def _say(self, what: str, **more: str) -> None:
        """Log a warning, at most once in an interval."""
        if time.monotonic() - self._said >= SAID_AGAIN_S:
            self._said = time.monotonic()
            waiting = f"{self._spool.bytes / 1e6:.1f} MB"
            log.warning(what, **more, waiting=waiting)
