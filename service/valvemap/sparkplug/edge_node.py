"""Messages of a Sparkplug B edge node. Pure: no clock, no network."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from valvemap.sparkplug.metrics import Tag, Value, add_plain
from valvemap.sparkplug.schema import DataType, Payload
from valvemap.sparkplug.structures import Change, Flat, Structure, add_births, add_changes

__all__ = ["NAMESPACE", "REBIRTH", "Change", "EdgeNode", "Message"]

NAMESPACE: Final = "spBv1.0"
REBIRTH: Final = "Node Control/Rebirth"
_BD_SEQ: Final = "bdSeq"
_NUMBERS: Final = 256  # seq and bdSeq wrap after 255
_METRICS_AT_ONCE: Final = 500  # metrics in one DATA message: some 25 kB


@dataclass(frozen=True)
class Message:
    """A message to publish, never retained; or one received, retained by the broker or not."""

    topic: str
    payload: bytes
    qos: int = 0
    retained: bool = False


class EdgeNode:
    """Sequence numbers of an edge node, and its messages.

    A connection begins with :meth:`will`, which is part of its CONNECT and takes the next
    ``bdSeq``. Then :meth:`births` declares all metrics, and :meth:`data` publishes changes. ``seq``
    counts these messages.

    Parameters
    ----------
    group, name
        Names of group and edge node, part of every topic.
    structure
        Arranges the metrics of devices; default: one by one.

    References
    ----------
    Sparkplug 3.0, chapters 4 to 6.

    Examples
    --------
    >>> node = EdgeNode("Plant", "Hall 3")
    >>> node.will(now=0).topic, node.bd_seq
    ('spBv1.0/Plant/NDEATH/Hall 3', 0)
    >>> [message.topic for message in node.births({"V1": ()}, {}, now=0)]
    ['spBv1.0/Plant/NBIRTH/Hall 3', 'spBv1.0/Plant/DBIRTH/Hall 3/V1']
    >>> node.seq
    2
    """

    def __init__(self, group: str, name: str, structure: Structure | None = None) -> None:
        self.bd_seq = -1
        self.seq = 0
        self._group, self._name = group, name
        self._structure = Flat() if structure is None else structure

    @property
    def commands(self) -> str:
        """Topic of commands to the node (NCMD)."""
        return self._topic("NCMD")

    @property
    def device_commands(self) -> str:
        """Filter of the topics of commands to all devices (DCMD)."""
        return self._topic("DCMD", "+")

    def device_of(self, topic: str) -> str | None:
        """Return the device to which a command was sent; None if the topic is another.

        >>> EdgeNode("G", "N").device_of("spBv1.0/G/DCMD/N/V1")
        'V1'
        """
        start = self._topic("DCMD", "")
        return topic[len(start) :] if topic.startswith(start) else None

    def will(self, now: int) -> Message:
        """Return the will of the next connection: an NDEATH with the next bdSeq."""
        self.bd_seq = (self.bd_seq + 1) % _NUMBERS
        return self.death(now)

    def death(self, now: int) -> Message:
        """Return the NDEATH of this connection, to publish before a disconnect."""
        payload = Payload(timestamp=now // 1_000_000)
        add_plain(payload, _BD_SEQ, DataType.INT64, self.bd_seq, now)
        return Message(self._topic("NDEATH"), payload.SerializeToString(), qos=1)

    def births(
        self, tags: Mapping[str | None, Sequence[Tag]], newest: Mapping[str, Value], now: int
    ) -> list[Message]:
        """Return NBIRTH and the DBIRTH of each device: all metrics with their current values.

        ``tags`` is keyed by device; None is the node itself. A metric without a value is null and
        STALE.
        """
        self.seq = 0
        payload = self._payload(now)
        add_plain(payload, _BD_SEQ, DataType.INT64, self.bd_seq, now)
        add_plain(payload, REBIRTH, DataType.BOOLEAN, False, now)  # noqa: FBT003 - a value
        self._structure.define(payload, tags, now)
        add_births(payload, _with_values(tags.get(None, ()), newest, now))
        messages = [self._message("BIRTH", None, payload)]
        for device, own in tags.items():
            if device is not None:
                payload = self._payload(now)
                self._structure.bear(payload, device, _with_values(own, newest, now), now)
                messages.append(self._message("BIRTH", device, payload))
        return messages

    def data(self, changes: Iterable[Change], born: int, now: int) -> Iterator[Message]:
        """Yield NDATA and DDATA; changes numbered up to ``born`` are marked historical."""
        by_device: dict[str | None, list[Change]] = {}
        for change in changes:
            by_device.setdefault(change.tag.device, []).append(change)
        for device, own in by_device.items():
            for start in range(0, len(own), _METRICS_AT_ONCE):
                payload = self._payload(now)
                some = own[start : start + _METRICS_AT_ONCE]
                if device is None:
                    add_changes(payload, some, born)
                else:
                    self._structure.change(payload, device, some, born)
                yield self._message("DATA", device, payload)

    def device_death(self, device: str, now: int) -> Message:
        """Return the DDEATH of a device."""
        return self._message("DEATH", device, self._payload(now))

    def _payload(self, now: int) -> Any:  # noqa: ANN401
        payload = Payload(timestamp=now // 1_000_000, seq=self.seq)
        self.seq = (self.seq + 1) % _NUMBERS
        return payload

    def _message(self, verb: str, device: str | None, payload: Any) -> Message:  # noqa: ANN401
        verb = f"{'N' if device is None else 'D'}{verb}"
        return Message(self._topic(verb, device), payload.SerializeToString())

    def _topic(self, verb: str, device: str | None = None) -> str:
        whole = f"{NAMESPACE}/{self._group}/{verb}/{self._name}"
        return whole if device is None else f"{whole}/{device}"


def _with_values(
    tags: Sequence[Tag], newest: Mapping[str, Value], now: int
) -> list[tuple[Tag, Value]]:
    return [(tag, newest.get(tag.id, Value(None, _UNKNOWN, now))) for tag in tags]


_UNKNOWN: Final = 0x4000_0000  # Uncertain: no value has been read yet
