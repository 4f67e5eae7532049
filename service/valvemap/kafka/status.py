"""Status of a fleet by group: its worker, lag and block counters."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from confluent_kafka import Consumer, TopicPartition
from confluent_kafka.admin import AdminClient

from valvemap.kafka.broker import client_settings, speaking_to
from valvemap.kafka.catalogue import load_catalogue
from valvemap.kafka.decoding import Decoder, Rejected
from valvemap.kafka.group import COUNTS
from valvemap.kafka.memory import Memory
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.state_topic import Kept, memories
from valvemap.kafka.topics import SAMPLES, STATE, WORKERS, check_partitions, topic_name


@dataclass(frozen=True)
class GroupStatus:
    """One group.

    Attributes
    ----------
    name
        Its name.
    partition
        Partition of its messages; None before the first block was processed.
    owner
        The assigned worker, ``client@host``; empty without one.
    lag
        Unprocessed messages of its partition, including those of other groups.
    memory
        Its checkpoint.
    size
        Size of the checkpoint, bytes.
    fault
        Reason why the checkpoint cannot be decoded, if so.
    """

    name: str
    partition: int | None
    owner: str = ""
    lag: int = 0
    memory: Memory | None = None
    size: int = 0
    fault: str = ""

    @property
    def newest(self) -> int:
        """Source time of its newest sample, UTC ns; 0 without one."""
        columns = () if self.memory is None else self.memory.columns
        signals = (one.arrays["newest_t"] for one in columns if "newest_t" in one.arrays)
        return int(max((t.max(initial=0) for t in signals), default=np.int64(0)))


def status(config: FleetConfig) -> list[GroupStatus]:
    """Return the status of all groups of the catalogue.

    Raises
    ------
    ConfigurationError, FleetError
        if catalogue or broker cannot be read, or a topic is missing.
    """
    catalogue = load_catalogue(config.catalogue)
    check_partitions(config, SAMPLES, STATE)
    reader = Consumer(
        {
            **client_settings(config.broker),
            "group.id": f"{config.topics.prefix}.{WORKERS}",
            "enable.auto.commit": False,
            "log_level": 0,
        }
    )
    try:
        with speaking_to(config.broker):
            kept = dict(memories(reader, config, set(catalogue.groups)))
            lags = _lags(reader, config)
            owners = _owners(config)
    finally:
        reader.close()
    decoder = Decoder(catalogue, config.topics)
    return [_of(name, kept.get(name), lags, owners, decoder) for name in catalogue.groups]


def lines(found: list[GroupStatus], now: int) -> Iterator[str]:
    r"""Format as a table; ``now`` is UTC ns.

    >>> print(*lines([GroupStatus("north.0", None)], 0), sep="\n")
    group    partition  lag  block  age s  kB  owner
    north.0  -          -    -      -      -   nobody
    """
    head = ("group", "partition", "lag", "block", "age s", "kB", *_ODD, "owner")
    rows = [head, *(_row(one, now) for one in found)]
    shown = [
        k for k, name in enumerate(head) if name not in _ODD or any(r[k] != "-" for r in rows[1:])
    ]
    widths = [max(len(row[k]) for row in rows) for k in shown]
    for row in rows:
        cells = (row[k].ljust(width) for k, width in zip(shown, widths, strict=True))
        yield "  ".join(cells).rstrip()
    for one in found:
        if one.fault:
            yield f"group {one.name}: {one.fault}"


_ODD = COUNTS  # columns omitted while all zero


def _row(one: GroupStatus, now: int) -> tuple[str, ...]:
    owner = one.owner or "nobody"
    if one.memory is None or one.partition is None:
        return (one.name, *["-"] * (5 + len(_ODD)), owner)
    age = f"{(now - one.newest) * 1e-9:.1f}" if one.newest else "-"
    odd = (str(one.memory.counts.get(name, 0) or "-") for name in _ODD)
    kB = f"{one.size / 1000:.0f}"
    return one.name, f"{one.partition}", f"{one.lag}", f"{one.memory.number}", age, kB, *odd, owner


def _of(
    name: str,
    kept: Kept | None,
    lags: Mapping[int, int],
    owners: Mapping[int, str],
    decoder: Decoder,
) -> GroupStatus:
    if kept is None:
        return GroupStatus(name, None)
    where = kept.partition
    owner, lag = owners.get(where, ""), lags.get(where, 0)
    memory = decoder.memory(kept.packed)
    if isinstance(memory, Rejected):
        return GroupStatus(name, where, owner, lag, size=len(kept.packed), fault=memory.reason)
    return GroupStatus(name, where, owner, lag, memory, len(kept.packed))


def _lags(reader: Consumer, config: FleetConfig) -> dict[int, int]:
    topic, timeout_s = topic_name(config.topics, SAMPLES), config.broker.timeout_s
    places = [TopicPartition(topic, p) for p in range(config.topics.partitions)]
    found = {}
    for place in reader.committed(places, timeout=timeout_s):
        low, high = reader.get_watermark_offsets(place, timeout=timeout_s)
        found[place.partition] = high - max(place.offset, low)
    return found


def _owners(config: FleetConfig) -> dict[int, str]:
    group, topic = f"{config.topics.prefix}.{WORKERS}", topic_name(config.topics, SAMPLES)
    admin = AdminClient({**client_settings(config.broker), "log_level": 0})
    outcome = admin.describe_consumer_groups([group], request_timeout=config.broker.timeout_s)
    return {
        place.partition: f"{member.client_id}@{member.host.lstrip('/')}"
        for member in outcome[group].result().members
        for place in member.assignment.topic_partitions
        if place.topic == topic
    }
