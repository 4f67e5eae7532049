"""The state topic: checkpoints of each group, readable by any consumer."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from confluent_kafka import Consumer, KafkaException, TopicPartition

from valvemap.errors import FleetError
from valvemap.kafka.broker import reason
from valvemap.kafka.memory import MAGIC
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.topics import STATE, topic_name

_POLL_S: Final = 1.0
_SEPARATOR: Final = b"|"  # Quix Streams' separator between message key and state key
_PREFIX_BYTES: Final = 16  # bytes; Quix Streams' expiry timestamp before a value


@dataclass(frozen=True)
class Kept:
    """A group's checkpoint in the state topic, and its offset."""

    partition: int
    packed: bytes


def memories(
    reader: Consumer, config: FleetConfig, groups: Collection[str]
) -> Iterator[tuple[str, Kept]]:
    """Read the whole topic, which is compacted: the last checkpoint of a group is the current one.

    Raises
    ------
    FleetError
    KafkaException
    """
    topic = topic_name(config.topics, STATE)
    names = {name.encode(): name for name in groups}
    places = [TopicPartition(topic, p, 0) for p in range(config.topics.partitions)]
    ends = {
        p.partition: reader.get_watermark_offsets(p, timeout=config.broker.timeout_s)
        for p in places
    }
    reader.assign([TopicPartition(topic, p, low) for p, (low, _) in ends.items()])
    while not _is_at_the_end(reader, places, {p: high for p, (_, high) in ends.items()}):
        message = reader.poll(_POLL_S)
        if message is None:
            continue
        if message.error() is not None:
            raise FleetError(f"{topic}: {reason(KafkaException(message.error()))}")
        value, key = message.value() or b"", message.key() or b""
        at = value.find(MAGIC, 0, _PREFIX_BYTES + len(MAGIC))
        name = names.get(key.partition(_SEPARATOR)[0])
        if at >= 0 and name is not None:
            yield name, Kept(message.partition(), value[at:])


def _is_at_the_end(reader: Consumer, places: list[TopicPartition], ends: Mapping[int, int]) -> bool:
    now = reader.position([TopicPartition(p.topic, p.partition) for p in places])
    return all(p.offset >= ends[p.partition] or ends[p.partition] == 0 for p in now)
