"""Current values of all metrics; changes are queued in the outbox. Pure."""

from collections.abc import Iterable, Mapping
from itertools import count
from typing import Final, NamedTuple

from valvemap.sparkplug.metrics import BAD_NO_COMMUNICATION, GOOD, Meaning, Tag, Value, alike
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.schema import DataType
from valvemap.vocabulary.commands import Action

LOST: Final = "MQTT.Lost"
OVERFLOWS: Final = "MQTT.Overflows"
REFUSED: Final = "MQTT.Refused"
CONNECTIONS: Final = "MQTT.Connections"
CONNECTED: Final = "MQTT.ServiceConnected"
COMMANDS_DONE: Final = "MQTT.CommandsDone"
COMMANDS_REFUSED: Final = "MQTT.CommandsRefused"
COMMANDS_LOST: Final = "MQTT.CommandsLost"
LAST_REFUSAL: Final = "MQTT.LastRefusal"
_OWN: Final = {
    LOST: DataType.UINT64,
    OVERFLOWS: DataType.UINT64,
    REFUSED: DataType.UINT64,
    CONNECTIONS: DataType.UINT64,
    CONNECTED: DataType.BOOLEAN,
    COMMANDS_DONE: DataType.UINT64,
    COMMANDS_REFUSED: DataType.UINT64,
    COMMANDS_LOST: DataType.UINT64,
    LAST_REFUSAL: DataType.STRING,
}


class Variable(NamedTuple):
    """A variable of a valve, or (``device`` is None) of the service itself.

    ``action`` is the command that a client may give by it. ``text`` is the value of a metric that
    has no variable behind it, and never changes.
    """

    id: str
    device: str | None
    name: str
    kind: DataType
    meaning: Meaning = Meaning()
    action: Action | None = None
    text: str | None = None


class Shown:
    """Metrics by device, and their current values.

    Parameters
    ----------
    outbox
        Receives the changes.
    now
        UTC ns.

    Attributes
    ----------
    tags : dict
        Metrics of each device; None: those of the edge node.
    newest : dict
        Current values, by id of the variable.
    found_count : int
        Number of times the service was browsed; births are due when it has increased.
    is_connected : bool
        Whether the service is connected.

    Examples
    --------
    >>> shown = Shown(Outbox(most=100), now=0)
    >>> flow = Variable("V1.Signals.Q", "V1", "Signals/Q", DataType.DOUBLE)
    >>> shown.find([flow], {"V1.Signals.Q": Value(60.0, GOOD, 1)}, now=1)
    >>> [tag.name for tag in shown.tags["V1"]]
    ['Signals/Q']
    """

    def __init__(self, outbox: Outbox, now: int) -> None:
        self.found_count = 0
        self.is_connected = False
        self.newest: dict[str, Value] = {}
        self.tags: dict[str | None, list[Tag]] = {}
        self._outbox = outbox
        self._aliases: dict[str, int] = {}
        self._next_alias = count(1)
        self._by_id: dict[str, Tag] = {}
        self._by_key: dict[tuple[str | None, str | int], Tag] = {}
        self._own = [Variable(id_, None, id_.replace(".", "/"), kind) for id_, kind in _OWN.items()]
        starts = {
            id_: Value(_own_value(id_, _START[kind]), GOOD, now) for id_, kind in _OWN.items()
        }
        self._take_over(self._own, starts)

    def find(self, variables: Iterable[Variable], values: Mapping[str, Value], now: int) -> None:
        """Replace all variables and values after the service was browsed."""
        self._take_over([*self._own, *variables], values)
        self._outbox.keep_only(self._by_id.values())
        self.is_connected = True
        self.found_count += 1
        self.count(CONNECTED, 1, now)

    def find_tag(self, device: str, key: str | int) -> Tag | None:
        """Return the metric of a device with this name or alias."""
        return self._by_key.get((device, key))

    def change(self, id_: str, value: Value) -> None:
        """Store a value and queue the change, if value or quality differ."""
        tag = self._by_id.get(id_)
        if tag is None or (id_ in self.newest and alike(self.newest[id_], value)):
            return
        self.newest[id_] = value
        self._outbox.put(tag, value)

    def count(self, id_: str, number: int | str, now: int) -> None:
        """Set one of the publisher's own counters, or its text."""
        self.change(id_, Value(_own_value(id_, number), GOOD, now))

    def lose(self, now: int) -> None:
        """Mark all variables as bad after the service was lost."""
        if not self.is_connected:
            return
        self.is_connected = False
        gone = Value(None, BAD_NO_COMMUNICATION, now)
        for id_, tag in self._by_id.items():
            if id_ in _OWN:
                continue
            if tag.device is None:
                self.change(id_, gone)
            else:
                self.newest[id_] = gone  # DDEATH reports it
        self.count(CONNECTED, 0, now)

    def _take_over(self, variables: Iterable[Variable], values: Mapping[str, Value]) -> None:
        own = {id_: value for id_, value in self.newest.items() if id_ in _OWN}
        self.newest = {**own, **values}
        self._by_id, self._by_key, self.tags = {}, {}, {None: []}
        for id_, device, name, kind, meaning, action, _ in variables:
            if id_ not in self._aliases:
                self._aliases[id_] = next(self._next_alias)
            tag = Tag(id_, device, name, kind, self._aliases[id_], meaning, action)
            self._by_id[id_] = tag
            self._by_key[device, name] = self._by_key[device, tag.alias] = tag
            self.tags.setdefault(device, []).append(tag)


_START: Final[Mapping[DataType, int | str]] = {
    DataType.UINT64: 0,
    DataType.BOOLEAN: 0,
    DataType.STRING: "",
}


def _own_value(id_: str, value: int | str) -> int | str | bool:
    return bool(value) if _OWN[id_] is DataType.BOOLEAN else value
