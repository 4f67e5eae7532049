"""The fleet's topics: created if missing, else checked."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from confluent_kafka import KafkaError, KafkaException
from confluent_kafka.admin import AdminClient, ConfigResource, NewTopic, ResourceType

from valvemap.errors import FleetError
from valvemap.kafka.broker import client_settings, reason, silent, speaking_to
from valvemap.kafka.settings import BrokerConfig, FleetConfig, TopicsConfig

SAMPLES: Final = "samples"
COMMANDS: Final = "commands"
RESULTS: Final = "results"
REJECTED: Final = "rejected"  # dead letters
STATE: Final = "state"  # Quix Streams' changelog
WORKERS: Final = "work"  # the workers' consumer group, after the prefix
_MS_PER_H: Final = 3_600_000
_LOOK_AGAIN_S: Final = 0.1
_SMALLEST_SEGMENT: Final = 16_000_000  # bytes; unit of compaction


@dataclass(frozen=True)
class Topic:
    """Expected properties of one topic; ``settings`` are Kafka's own."""

    name: str
    partitions: int
    replication: int
    settings: Mapping[str, str]


def topic_name(topics: TopicsConfig, kind: str) -> str:
    """The name of one of our topics.

    >>> topic_name(TopicsConfig(), SAMPLES)
    'valvemap.samples'
    """
    return f"{topics.prefix}.{kind}"


def wanted(topics: TopicsConfig) -> list[Topic]:
    """Return all topics; those a worker consumes together have equal numbers of partitions."""
    largest = str(round(topics.message_mb * 1e6))
    kept = {
        SAMPLES: {"cleanup.policy": "delete", "retention.ms": _ms(topics.samples_h)},
        COMMANDS: {"cleanup.policy": "delete", "retention.ms": _ms(topics.samples_h)},
        RESULTS: {"cleanup.policy": "delete", "retention.ms": _ms(topics.results_h)},
        REJECTED: {"cleanup.policy": "delete", "retention.ms": _ms(topics.samples_h)},
        STATE: {"cleanup.policy": "compact", "segment.bytes": str(_SMALLEST_SEGMENT)},
    }
    return [
        Topic(
            name=topic_name(topics, kind),
            partitions=topics.partitions,
            replication=topics.replication,
            settings={
                **settings,
                "max.message.bytes": largest,
                "min.insync.replicas": str(max(1, topics.replication - 1)),
            },
        )
        for kind, settings in kept.items()
    ]


def create_or_check(config: FleetConfig) -> Iterator[str]:
    """Create missing topics and check existing ones; yield a line for each.

    Raises
    ------
    FleetError
        if the broker cannot be reached or refuses; at the end, a line for each contradiction.
    """
    broker = config.broker
    admin, topics = _admin(broker), wanted(config.topics)
    with speaking_to(broker):
        there = admin.list_topics(timeout=broker.timeout_s).topics
    missing = [topic for topic in topics if topic.name not in there]
    made = [topic for topic in missing if _create(admin, topic, broker)]
    for topic in made:
        yield f"{topic.name}: made, {topic.partitions} partitions on {topic.replication} brokers"
    if missing:
        there = _all_there(admin, topics, broker)
    against: list[str] = []
    for topic in topics:
        if topic in made:
            continue
        found = contradictions(topic, _as_it_is(admin, topic.name, there[topic.name], broker))
        if not found:
            yield f"{topic.name}: as configured"
        against += found
    if against:
        raise FleetError("\n".join(against))


def check_partitions(config: FleetConfig, *kinds: str) -> None:
    """Check that topics exist and have the configured number of partitions.

    Raises
    ------
    FleetError
        with a line for each that does not.
    """
    broker = config.broker
    with speaking_to(broker):
        there = _admin(broker).list_topics(timeout=broker.timeout_s).topics
    against = []
    for kind in kinds:
        name, expected = topic_name(config.topics, kind), config.topics.partitions
        if name not in there:
            against.append(f"{name}: no such topic; `valvemap fleet topics` makes it")
        elif len(there[name].partitions) != expected:
            against.append(_partitions(name, len(there[name].partitions), expected))
    if against:
        raise FleetError("\n".join(against))


def contradictions(topic: Topic, found: Topic) -> list[str]:
    """Return the differences between a topic and its configuration, a line for each.

    >>> one = Topic("t", 12, 3, {"retention.ms": "100"})
    >>> contradictions(one, Topic("t", 12, 1, {"retention.ms": "50"}))
    ['t: on 1 brokers, 3 wanted: topics.replication', 't: retention.ms = 50, 100 wanted']
    """
    said = []
    if found.partitions != topic.partitions:
        said.append(_partitions(topic.name, found.partitions, topic.partitions))
    if found.replication != topic.replication:
        said.append(
            f"{topic.name}: on {found.replication} brokers, {topic.replication} wanted: "
            "topics.replication"
        )
    said += [
        f"{topic.name}: {name} = {found.settings.get(name)}, {value} wanted"
        for name, value in topic.settings.items()
        if found.settings.get(name) != value
    ]
    return said


def _partitions(name: str, found: int, expected: int) -> str:
    return (
        f"{name}: {found} partitions, {expected} wanted: topics.partitions; a topic that has them "
        "cannot be changed, for each group's messages would go elsewhere"
    )


def _ms(hours: float) -> str:
    return str(round(hours * _MS_PER_H))


def _admin(broker: BrokerConfig) -> AdminClient:
    return AdminClient(client_settings(broker), logger=silent())


def _create(admin: AdminClient, topic: Topic, broker: BrokerConfig) -> bool:
    """Create a topic; return False if another client has created it first."""
    new = NewTopic(
        topic.name,
        num_partitions=topic.partitions,
        replication_factor=topic.replication,
        config=dict(topic.settings),
    )
    try:
        for outcome in admin.create_topics([new], request_timeout=broker.timeout_s).values():
            outcome.result()
    except KafkaException as error:
        if error.args[0].code() == KafkaError.TOPIC_ALREADY_EXISTS:
            return False
        raise FleetError(f"{topic.name}: cannot be made: {reason(error)}") from None
    return True


def _all_there(admin: AdminClient, topics: list[Topic], broker: BrokerConfig) -> dict[str, Any]:
    """Return all topics, once the brokers list those just created."""
    end = time.monotonic() + broker.timeout_s
    while True:
        with speaking_to(broker):
            there: dict[str, Any] = admin.list_topics(timeout=broker.timeout_s).topics
        missing = [topic.name for topic in topics if topic.name not in there]
        if not missing:
            return there
        if time.monotonic() > end:
            raise FleetError(f"{missing[0]}: made, but the brokers do not know it yet; try again")
        time.sleep(_LOOK_AGAIN_S)


def _as_it_is(admin: AdminClient, name: str, there: Any, broker: BrokerConfig) -> Topic:  # noqa: ANN401
    resource = ConfigResource(ResourceType.TOPIC, name)
    with speaking_to(broker):
        (outcome,) = admin.describe_configs([resource], request_timeout=broker.timeout_s).values()
        settings = {key: entry.value for key, entry in outcome.result().items()}
    partitions = there.partitions.values()
    replication = min((len(partition.replicas) for partition in partitions), default=0)
    return Topic(name, len(partitions), replication, settings)
