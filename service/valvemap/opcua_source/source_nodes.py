"""The nodes of a source as configured: each valve's signals and commands, one item each."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from valvemap.errors import ConfigurationError
from valvemap.opcua_source.elements import parted
from valvemap.opcua_source.node_ids import parse_node_id
from valvemap.opcua_source.structures import Path
from valvemap.pipeline.units import Measure
from valvemap.vocabulary.signals import PER_VALVE, READ, Signal

REQUIRED_U, LOAD, HEARTBEAT = "required_U", "load", "heartbeat"  # nodes that are written


@dataclass(frozen=True)
class ValveNodes:
    """The nodes of one valve's signals; each a NodeId such as ``nsu=urn:plant;s=Valve7.U``.

    A transmitter ``dp`` takes the place of ``p1`` and ``p2``; its changes come as those of p1, and
    p2 is 0. Optional are ``T``, ``sequence`` (a counter that increments with each sample),
    ``required_U`` (to which the feed-forward voltage is written), ``load`` (the set point of p2,
    which commissioning writes) and ``heartbeat`` (UInt32, incremented while U is written).
    ``measures`` holds by name the units of the signals and of the commands; ``insist`` accepts them
    even if the source's EngineeringUnits or EURange differ. For messages: ``kind`` (valve or axis),
    ``whole``, the valve of this edge or line, and ``words``, names of the signals.
    """

    valve: str
    U: str
    p1: str | None
    p2: str | None
    Q: str
    T: str | None = None
    sequence: str | None = None
    required_U: str | None = None
    load: str | None = None
    heartbeat: str | None = None
    measures: Mapping[str, Measure] = field(default_factory=dict)
    insist: bool = False
    dp: str | None = None
    kind: str = "valve"
    whole: str | None = None
    words: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the form of the NodeIds.

        Raises
        ------
        ConfigurationError
            if a NodeId is malformed.
        """
        for wanted in _of_valve(0, self):
            parse_node_id(wanted.text, ())
            if wanted.item is None and wanted.part is not None:
                part = "an element of an array" if isinstance(wanted.part, int) else "a member"
                raise ConfigurationError(f"{wanted.label}: {part} is not written")

    def measure(self, name: str) -> Measure:
        """Return the configured unit and scaling of a signal or of the command."""
        return self.measures.get(name, Measure())

    @property
    def title(self) -> str:
        """Its kind and name in messages."""
        return f"{self.kind} {self.whole or self.valve}"

    def word(self, name: str) -> str:
        """Return what a signal is called in messages."""
        return self.words.get(name, name)

    def source_of(self, name: str) -> str:
        """Return the node field that a signal comes from: dp for p1, where there is dp."""
        return "dp" if name == "p1" and self.dp is not None else name

    def signals(self) -> Iterator[tuple[Signal, str, str]]:
        """Yield signal, name and NodeId of all nodes to read."""
        named = zip(Signal, READ, strict=True)
        for signal, name in named:
            text = getattr(self, self.source_of(name))
            if text is not None:
                yield signal, self.source_of(name), text


@dataclass(frozen=True)
class Wanted:
    """One node as configured, with its label in messages; ``item`` is None if it is written."""

    item: int | None
    valve: int
    text: str
    role: str
    label: str

    @property
    def part(self) -> int | Path | None:
        """The element of an array or the member of a structure; None: the value itself."""
        return parted(self.text)[0]


def copies_of(valves: Sequence[ValveNodes]) -> dict[int, list[int]]:
    """Return the items whose node another item has, too: they are monitored once, by the first.

    >>> copies_of([ValveNodes("V1", "s=U", "s=p1", "s=p2", "s=Q")] * 2)
    {0: [6], 1: [7], 2: [8], 3: [9]}
    """
    first: dict[str, int] = {}
    found: dict[int, list[int]] = {}
    for number, valve in enumerate(valves):
        for signal, _, text in valve.signals():
            item = number * PER_VALVE + signal
            if first.setdefault(text, item) != item:
                found.setdefault(first[text], []).append(item)
    return found


def wanted_nodes(valves: Sequence[ValveNodes]) -> Iterator[Wanted]:
    """Yield every configured node of the given valves."""
    return (node for number, valve in enumerate(valves) for node in _of_valve(number, valve))


def _of_valve(number: int, nodes: ValveNodes) -> Iterator[Wanted]:
    def wanted(item: int | None, text: str, role: str) -> Wanted:
        label = f"node '{text}' ({nodes.word(role)} of {nodes.title})"
        return Wanted(item, number, text, role, label)

    for signal, name, text in nodes.signals():
        yield wanted(number * PER_VALVE + signal, text, name)
    for role in (REQUIRED_U, LOAD, HEARTBEAT):
        text = getattr(nodes, role)
        if text is not None:
            yield wanted(None, text, role)
