"""Commands of MQTT clients to devices (DCMD), between their arrival and the service. Pure.

MQTT does not tell who published a message: the broker's access list decides who may send commands,
and the service's role decides what the log-in of this program may do. Here a command is refused
unless it names a metric whose command the configuration allows, with a value of the metric's type
and range, recently sent.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from valvemap.foreign_text import printable
from valvemap.sparkplug.edge_node import Message
from valvemap.sparkplug.metrics import Tag
from valvemap.sparkplug.schema import DataType, DecodeError, Payload
from valvemap.sparkplug.shown import Shown
from valvemap.vocabulary.commands import Action

MOST_METRICS: Final = 100  # metrics in one command; a host writes one or two
_LONGEST_TEXT: Final = 200  # characters of a comment, as on the page
_LONGEST_NAME: Final = 100  # characters of a foreign name in a refusal
_FIELDS: Final = {DataType.DOUBLE: "double_value", DataType.STRING: "string_value"}


class Refused(Exception):  # noqa: N818 - it says what happened
    """A command that has no effect; the message says why."""


class Asked(NamedTuple):
    """One metric of a command: alias or name (None: not given), data type (0: not given), value."""

    alias: int | None
    name: str | None
    kind: int
    field: str | None
    value: Any


@dataclass(frozen=True, slots=True)
class Order:
    """A checked command: the value to write to a tag, and when it was sent, UTC ns."""

    tag: Tag
    action: Action
    value: float | str
    sent: int


class Commands:
    """Checks commands and keeps the newest of each metric until the service can take it.

    So at most one command per metric waits. A command that a newer one replaced is lost; one that
    has waited too long is refused.

    Parameters
    ----------
    allowed
        Names of the commands that clients may give.
    shown
        The metrics, and whether the service is connected.
    prefix
        May precede a metric's name, see `Structure`.
    max_age_s
        Largest difference between a command's timestamp and the clock, s, also when it is due.

    Attributes
    ----------
    done, refused, lost : int
        Number of commands carried out, refused, and replaced before they were due.
    last_refusal : str
        Reason of the last refusal.
    """

    def __init__(
        self, allowed: Collection[str], shown: Shown, prefix: str, max_age_s: float
    ) -> None:
        self.allowed = allowed
        self.done = self.refused = self.lost = 0
        self.last_refusal = ""
        self._shown, self._prefix = shown, prefix
        self._max_age_s = max_age_s
        self._waiting: dict[str, Order] = {}

    def hear(self, device: str, message: Message, now: int) -> None:
        """Take a message to a device; keep its valid commands, count the others."""
        try:
            sent, asked = self._open(message, now)
        except Refused as error:
            self.refuse(_short(device), str(error))
            return
        for one in asked:
            try:
                order = self._order(device, one, sent)
            except Refused as error:
                self.refuse(_said(device, one), str(error))
                continue
            self.lost += self._waiting.pop(order.tag.id, None) is not None
            self._waiting[order.tag.id] = order

    def take(self, now: int) -> Iterator[Order]:
        """Yield the commands that wait, in the order of their arrival; refuse those too old."""
        while self._waiting:
            order = self._waiting.pop(next(iter(self._waiting)))
            try:
                self._check_age(order.sent, now)
            except Refused as error:
                self.refuse(order.tag.id, str(error))
            else:
                yield order

    def refuse(self, what: str, reason: str) -> None:
        """Count a command as refused."""
        self.refused += 1
        self.last_refusal = f"{what}: {reason}"

    def _open(self, message: Message, now: int) -> tuple[int, list[Asked]]:
        if message.retained:
            raise Refused("a retained message is no command")
        if not self._shown.is_connected:
            raise Refused("the service is not connected")
        sent, asked = read_command(message.payload)
        self._check_age(sent, now)
        return sent, asked

    def _check_age(self, sent: int, now: int) -> None:
        age_s = (now - sent) / 1e9
        if not abs(age_s) <= self._max_age_s:
            raise Refused(f"its timestamp is {age_s:.3g} s old; {self._max_age_s:g} s are allowed")

    def _order(self, device: str, asked: Asked, sent: int) -> Order:
        tag = self._tag(device, asked)
        if tag.action is None:
            raise Refused("this metric takes no command")
        if asked.kind not in {0, tag.kind} or asked.field != _FIELDS[tag.kind]:
            raise Refused(f"a value of the type {tag.kind.name.capitalize()} is needed")
        if isinstance(asked.value, str):
            return Order(tag, tag.action, _checked_text(asked.value), sent)
        return Order(tag, tag.action, _checked_number(asked.value, tag.meaning.range), sent)

    def _tag(self, device: str, asked: Asked) -> Tag:
        named = None if asked.name is None else asked.name.removeprefix(self._prefix)
        found = {
            self._shown.find_tag(device, key) for key in (asked.alias, named) if key is not None
        }
        (tag,) = found if len(found) == 1 else (None,)
        if tag is None:
            raise Refused("there is no such metric")
        return tag


def read_command(data: bytes) -> tuple[int, list[Asked]]:
    """Return a command's timestamp (UTC ns) and its metrics, those of instances included.

    Raises
    ------
    Refused
        if ``data`` is no payload, or has no timestamp, no metric, or more than `MOST_METRICS`.
    """
    try:
        payload = Payload.FromString(data)
    except DecodeError:
        raise Refused("it is no payload of Sparkplug B") from None
    if not payload.HasField("timestamp"):
        raise Refused("it has no timestamp")
    asked: list[Asked] = []
    for metric in payload.metrics:
        members = metric.template_value.metrics if metric.HasField("template_value") else (metric,)
        asked += map(_asked, members[: MOST_METRICS + 1])
        if len(asked) > MOST_METRICS:
            raise Refused(f"it has more than {MOST_METRICS} metrics")
    if not asked:
        raise Refused("it has no metric")
    return payload.timestamp * 1_000_000, asked


def _asked(metric: Any) -> Asked:  # noqa: ANN401
    field = metric.WhichOneof("value")
    alias = metric.alias if metric.HasField("alias") else None
    name = metric.name or None
    if alias is None and name is None:
        raise Refused("a metric has neither name nor alias")
    is_simple = field in _FIELDS.values()
    value = getattr(metric, field) if is_simple and not metric.is_null else None
    if bytes in {type(name), type(value)}:  # how protobuf returns invalid UTF-8
        raise Refused("a text is not UTF-8")
    return Asked(alias, name, metric.datatype, None if value is None else field, value)


def _checked_text(text: str) -> str:
    if len(text) > _LONGEST_TEXT or (text and not text.isprintable()):
        raise Refused(f"a comment has at most {_LONGEST_TEXT} characters, in one line")
    return text


def _checked_number(number: float, bounds: tuple[float, float] | None) -> float:
    if not math.isfinite(number):
        raise Refused("a finite number is needed")
    if bounds is not None and not bounds[0] <= number <= bounds[1]:
        raise Refused(f"{number:g} is outside {bounds[0]:g} to {bounds[1]:g}")
    return float(number)


def _said(device: str, asked: Asked) -> str:
    return _short(f"{device} {asked.name if asked.name is not None else f'alias {asked.alias}'}")


def _short(name: str) -> str:
    return printable(name, _LONGEST_NAME)
