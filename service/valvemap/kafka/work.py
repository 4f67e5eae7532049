"""``valvemap fleet work``: a worker on Quix Streams, exactly once."""

import logging
import time
import uuid
import warnings
from collections.abc import Iterator
from functools import partial
from typing import Any, Final, Literal

import structlog
from confluent_kafka import KafkaException

from valvemap.app.metrics_address import MetricsAddress
from valvemap.app.serving_metrics import metrics_served
from valvemap.app.warm_up import warm_up
from valvemap.errors import FleetError, first_line
from valvemap.kafka.broker import client_settings, reason
from valvemap.kafka.catalogue import Catalogue, load_catalogue
from valvemap.kafka.client_statistics import EVERY_MS
from valvemap.kafka.dead_letters import DeadLetter, Place
from valvemap.kafka.group import Rhythm
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.topics import (
    COMMANDS,
    REJECTED,
    RESULTS,
    SAMPLES,
    STATE,
    WORKERS,
    check_partitions,
    topic_name,
)
from valvemap.kafka.worker import Worker
from valvemap.kafka.worker_metrics import WorkerMetrics
from valvemap.runtime.backoff import backoff

with warnings.catch_warnings(record=True):  # Quix Streams' dependencies warn on import
    from quixstreams import Application, message_context
    from quixstreams.exceptions import QuixException
    from quixstreams.kafka import ConnectionConfig
    from quixstreams.models import TopicAdmin, TopicManager
    from quixstreams.models.topics.exceptions import (
        TopicConfigurationMismatch,
        TopicNotFoundError,
        TopicPartitionsMismatch,
    )
    from quixstreams.sinks import BaseSink
    from quixstreams.state.exceptions import StateError, StateRecoveryOffsetOutOfRange

_BUFFERED: Final = 100  # messages of a partition, buffered to merge topics by time
_POLL_S: Final = 0.01  # s; longest wait for a full buffer
_FETCH_WAIT_MS: Final = 50  # ms; a long fetch delays other requests to the broker
_HEARTBEATS: Final = 4  # heartbeats in the session timeout
_ANOTHER_TRY_HELPS_NOT: Final = (
    TopicConfigurationMismatch,
    TopicNotFoundError,
    TopicPartitionsMismatch,
    StateError,
    StateRecoveryOffsetOutOfRange,
)

log = structlog.get_logger(__name__)


def work(config: FleetConfig, address: MetricsAddress | None = None) -> None:
    """Process messages until SIGINT or SIGTERM; retry if the broker is lost.

    Metrics are served at ``address``, if there is one.

    Raises
    ------
    ConfigurationError, FleetError
        if a retry cannot succeed: topics, catalogue, state.
    PageError
        if the address of the metrics cannot be used.
    """
    catalogue = load_catalogue(config.catalogue)
    check_partitions(config, SAMPLES, COMMANDS, RESULTS, REJECTED, STATE)
    for site in catalogue.sites.values():
        warm_up(site)
    _say_little(config)
    metrics = WorkerMetrics([topic_name(config.topics, kind) for kind in (SAMPLES, COMMANDS)])
    with metrics_served(address, metrics.points):
        _run_until_stopped(config, catalogue, metrics)


def _run_until_stopped(config: FleetConfig, catalogue: Catalogue, metrics: WorkerMetrics) -> None:
    pauses = backoff()
    while True:
        began = time.monotonic()
        try:
            _run(config, catalogue, metrics)
        except _ANOTHER_TRY_HELPS_NOT as error:
            raise FleetError(f"{first_line(error)}") from None
        except (KafkaException, QuixException) as error:
            said = reason(error) if isinstance(error, KafkaException) else first_line(error)
            if time.monotonic() - began > _LONG_ENOUGH_S:
                pauses = backoff()
            pause = next(pauses)
            log.warning("broker lost, uncommitted work is repeated", reason=said)
            metrics.note_restart()
            time.sleep(pause)
        else:
            return


_LONG_ENOUGH_S: Final = 60.0  # s; a run of this length resets the retry pause


def _run(config: FleetConfig, catalogue: Catalogue, metrics: WorkerMetrics) -> None:
    work, topics = config.work, config.topics
    rhythm = Rhythm(round(work.results_s * 1e9), round(work.maps_s * 1e9))
    worker = Worker(catalogue, rhythm, topics, metrics)
    app = _application(config, metrics)
    raw = {"key_deserializer": "bytes", "value_deserializer": "bytes"}
    samples = app.dataframe(app.topic(topic_name(topics, SAMPLES), **raw))
    commands = app.dataframe(app.topic(topic_name(topics, COMMANDS), **raw))
    written = {"key_serializer": "bytes", "value_serializer": "bytes"}
    results = app.topic(topic_name(topics, RESULTS), **written)
    dead_letters = app.topic(topic_name(topics, REJECTED), **written)
    tagged = samples.apply(partial(_tagged, SAMPLES)), commands.apply(partial(_tagged, COMMANDS))
    together = tagged[0].concat(tagged[1])
    learnt = together.apply(
        partial(_handle, worker, metrics), stateful=True, metadata=True, expand=True
    )
    learnt.filter(_is_result).to_topic(results)
    rejected = learnt.filter(_is_rejected).set_headers(_headers_of)
    rejected.apply(_payload_of).to_topic(dead_letters)
    learnt.sink(_Keeper(worker, metrics))
    app.run()


class _Keeper(BaseSink):
    """Writes the checkpoints before each commit, in its transaction."""

    def __init__(self, worker: Worker, metrics: WorkerMetrics) -> None:
        super().__init__()
        self._worker, self._metrics = worker, metrics

    def add(self, *_row: Any, **_place: Any) -> None:  # noqa: ANN401
        """Do nothing: results are sent to their topic."""

    def flush(self) -> None:
        """Write the checkpoints; called by the engine before it commits."""
        self._worker.keep()
        self._metrics.note_commit()


class _AwayInOneLine(logging.Handler):
    """Reduces the log of Kafka's clients to one message: no broker can be reached."""

    def __init__(self, addresses: str) -> None:
        super().__init__()
        self._addresses = addresses
        self._due = 0.0

    def emit(self, record: logging.LogRecord) -> None:
        """Log the message, at most once a minute."""
        now = time.monotonic()
        if _ALL_DOWN in record.getMessage() and now >= self._due:
            self._due = now + _AGAIN_S
            log.warning("broker cannot be reached, waiting for it", addresses=self._addresses)


_ALL_DOWN: Final = "brokers are down"
_AGAIN_S: Final = 60.0


def _say_little(config: FleetConfig) -> None:
    """Silence librdkafka's log: exceptions carry the reasons."""
    quix = logging.getLogger("quixstreams")
    quix.handlers = [_AwayInOneLine(",".join(config.broker.addresses))]
    quix.setLevel(logging.ERROR)
    quix.propagate = False


def _tagged(kind: str, value: bytes | None) -> tuple[str, bytes]:
    return kind, value or b""


def _handle(
    worker: Worker,
    metrics: WorkerMetrics,
    value: tuple[str, bytes],
    key: bytes | None,
    timestamp: int,
    _headers: Any,  # noqa: ANN401 - Quix's
    state: Any,  # noqa: ANN401
) -> Iterator[bytes | DeadLetter]:
    kind, message = value
    if kind == SAMPLES:
        sent = timestamp * 1_000_000 if timestamp > 0 else None
        out = worker.samples(key, message, state, sent)
    else:
        out = worker.command(key, message, state)
    metrics.note_message(kind, key, message_context().partition)
    return iter([*out, *worker.rejected()])


def _is_result(value: bytes | DeadLetter) -> bool:
    return isinstance(value, bytes)


def _is_rejected(value: bytes | DeadLetter) -> bool:
    return isinstance(value, DeadLetter)


def _headers_of(
    letter: DeadLetter,
    _key: bytes | None,
    _timestamp: int,
    _headers: Any,  # noqa: ANN401 - Quix's
) -> list[tuple[str, bytes]]:
    at = message_context()
    return letter.headers(Place(at.topic, at.partition, at.offset))


def _payload_of(letter: DeadLetter) -> bytes:
    return letter.payload


class _OwnNames(TopicManager):
    """Quix Streams' topics, with the configured name of the changelog."""

    def __init__(self, changelog: str, **more: Any) -> None:  # noqa: ANN401
        super().__init__(**more)
        self._changelog = changelog

    def _internal_name(
        self, topic_type: Literal["changelog", "repartition"], topic_name: str | None, suffix: str
    ) -> str:
        if topic_type == "changelog":
            return self._changelog
        return super()._internal_name(topic_type, topic_name, suffix)


def _application(config: FleetConfig, metrics: WorkerMetrics) -> Any:  # noqa: ANN401
    broker, topics, work = config.broker, config.topics, config.work
    connection = ConnectionConfig.from_librdkafka_dict(client_settings(broker))
    group, largest = f"{topics.prefix}.{WORKERS}", round(topics.message_mb * 1e6)
    commit_ms, takeover_ms = round(work.commit_s * 1e3), round(work.takeover_s * 1e3)
    manager = _OwnNames(
        topic_name(topics, STATE),
        topic_admin=TopicAdmin(broker_address=connection),
        consumer_group=group,
        timeout=broker.timeout_s,
        auto_create_topics=False,
    )
    work.state.mkdir(parents=True, exist_ok=True)
    return Application(
        broker_address=connection,
        consumer_group=group,
        topic_manager=manager,
        auto_create_topics=False,
        auto_offset_reset="earliest",
        auto_recover_from_source_offset_out_of_range=False,
        processing_guarantee="exactly-once",
        commit_interval=work.commit_s,
        state_dir=work.state,
        consumer_poll_timeout=_POLL_S,
        max_partition_buffer_size=_BUFFERED,
        broker_availability_timeout=0,
        on_processing_error=lambda _error, _row, _logger: False,
        loglevel=None,
        consumer_extra_config={
            "session.timeout.ms": takeover_ms,
            "heartbeat.interval.ms": takeover_ms // _HEARTBEATS,
            "fetch.wait.max.ms": _FETCH_WAIT_MS,
            "fetch.max.bytes": 4 * largest,
            "receive.message.max.bytes": 8 * largest,
            "statistics.interval.ms": EVERY_MS,
            "stats_cb": metrics.note_consumer,
        },
        producer_extra_config={
            "transactional.id": f"{group}.{uuid.uuid4()}",  # ACLs allow the prefix
            "compression.type": "none",  # results are compressed; checkpoints hardly shrink
            "message.max.bytes": largest,
            # It begins with the first message after a commit and must outlast the commit interval.
            "transaction.timeout.ms": commit_ms + takeover_ms,
            # Messages are sent at the commit, and invisible before it. With a short linger and a
            # slow broker, librdkafka would busy-wait and take half a core.
            "linger.ms": min(commit_ms, takeover_ms // 2),
            "statistics.interval.ms": EVERY_MS,
            "stats_cb": metrics.note_producer,
        },
    )
