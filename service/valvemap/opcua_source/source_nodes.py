"""The nodes of a source server: parses their NodeIds and checks existence, access and type."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from uuid import UUID

from asyncua import ua

from valvemap.clock import utc_ns
from valvemap.errors import ConfigurationError, SourceRejected
from valvemap.foreign_text import printable
from valvemap.opcua_client.connection import Connection, in_one_line, status_name
from valvemap.opcua_client.requests import namespaces_of, read_attributes
from valvemap.opcua_source.elements import parted
from valvemap.opcua_source.members import Member, Path
from valvemap.opcua_source.type_definitions import member_of
from valvemap.opcua_source.wire import NUMERIC_FORMATS
from valvemap.pipeline.units import Measure
from valvemap.vocabulary.item_states import ItemState
from valvemap.vocabulary.signals import PER_VALVE, READ, Signal

REQUIRED_U, LOAD, HEARTBEAT = "required_U", "load", "heartbeat"  # nodes that are written

_NODE_ID = re.compile(
    r"(?:ns=(?P<index>\d{1,5});|nsu=(?P<uri>[^;]+);)?(?P<kind>[isgb])=(?P<name>.+)", re.DOTALL
)
_ALLOWED = (
    "allowed are [ns=<index>;|nsu=<uri>;]s=<text>, i=<number>, g=<guid> or b=<base64>; before it "
    "index=<number>; for an element of an array, or member=<name>.<name>; for a member of a "
    "structure"
)

_ATTRIBUTES = (
    ua.AttributeIds.NodeClass,
    ua.AttributeIds.DataType,
    ua.AttributeIds.ValueRank,
    ua.AttributeIds.UserAccessLevel,
    ua.AttributeIds.Value,
)
_NUMBERS = "a Boolean, an integer, Float or Double"
_ABSTRACT_NUMBERS = {26, 27, 28}  # Number, Integer, UInteger
_BUILT_IN = {kind.value for kind in ua.VariantType}
_SCALARS = {-3, -2, -1}  # ScalarOrOneDimension, Any, Scalar


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


@dataclass(frozen=True)
class Looked:
    """One node as it is at the server.

    Attributes
    ----------
    node
        Its NodeId; None if the server does not know its namespace.
    fault, state
        Why it cannot be used, as the end of a sentence, and its state; None and GOOD: it can.
    type
        Built-in type of its values; None: not known yet.
    status, time
        StatusCode of its value, and its source time, UTC ns (0: none).
    place
        The signal's place in an array or a structure; None: the value itself.
    """

    node: ua.NodeId | None
    fault: str | None
    state: ItemState = ItemState.GOOD
    type: int | None = None
    status: int = 0
    time: int = 0
    place: int | Member | None = None


@dataclass(frozen=True)
class MonitoredNode:
    """A node to subscribe to, the item number of its changes, and their type (None: unknown).

    ``place`` is the signal's place in an array or a structure; None: the value itself.
    """

    item: int
    node: ua.NodeId
    label: str
    type: int | None = None
    place: int | Member | None = None

    @property
    def index_range(self) -> str | None:
        """The element in requests for it alone (Part 4, 7.27)."""
        return str(self.place) if isinstance(self.place, int) else None


@dataclass(frozen=True)
class WritableNode:
    """A node to write to, its data type, and its label in error messages."""

    node: ua.NodeId
    type: ua.VariantType
    label: str


@dataclass(frozen=True)
class CheckedNodes:
    """The nodes to subscribe to, and the nodes to write to by valve and role.

    ``faults`` are the unusable nodes by item, as sentences; ``namespaces`` the NamespaceArray.
    """

    monitored: tuple[MonitoredNode, ...]
    writable: dict[tuple[int, str], WritableNode]
    faults: Mapping[int, str] = field(default_factory=dict)
    namespaces: tuple[str, ...] = ()


def parse_node_id(text: str, namespaces: Sequence[str] | None = None) -> ua.NodeId:
    """Parse the text form of a NodeId.

    Parameters
    ----------
    text
        The text form (OPC UA Part 6, 5.3.1.10).
    namespaces
        The server's NamespaceArray; if empty, only the form is checked.

    Raises
    ------
    ConfigurationError
        if the form is invalid.
    SourceRejected
        if the server does not know the namespace.

    Examples
    --------
    >>> parse_node_id("nsu=urn:plant;s=Valve;7.U", ["urn:ua", "urn:other", "urn:plant"])
    NodeId(Identifier='Valve;7.U', NamespaceIndex=2, NodeIdType=<NodeIdType.String: 3>)
    """
    match = _NODE_ID.fullmatch(parted(text)[1])
    if match is None:
        raise ConfigurationError(f"node '{printable(text)}' is no NodeId; {_ALLOWED}")
    index = int(match["index"] or 0)
    if match["uri"] is not None and namespaces:
        if match["uri"] not in namespaces:
            raise SourceRejected(
                f"node '{printable(text)}': the server has no namespace {printable(match['uri'])}; "
                f"it has {in_one_line(', '.join(namespaces))}"
            )
        index = list(namespaces).index(match["uri"])
    try:
        match match["kind"]:
            case "i":
                return ua.NodeId(_uint32(match["name"]), index)
            case "g":
                return ua.NodeId(UUID(match["name"]), index)
            case "b":
                return ua.NodeId(ua.NodeId.from_string(f"b={match['name']}").Identifier, index)
            case _:
                return ua.NodeId(match["name"], index)
    except (ValueError, ua.UaError) as error:
        raise ConfigurationError(f"node '{printable(text)}' is no NodeId; {_ALLOWED}") from error


async def check_nodes(
    connection: Connection,
    valves: Sequence[ValveNodes],
    before: Sequence[str] = (),
    *,
    lenient: bool = False,
) -> CheckedNodes:
    """Read every node once.

    ``before`` is the NamespaceArray for which ``ns=<index>`` was meant; empty: the present one.
    If ``lenient``, unusable nodes are left out, unless all are unusable.

    Raises
    ------
    SourceRejected
        if a node is missing, unreadable, not writable or not a number; names the first one.
    SourceLost
    """
    wanted = list(wanted_nodes(valves))
    namespaces = await namespaces_of(connection)
    looked = await look(connection, wanted, namespaces, before)
    monitored, writable, faults = [], {}, {}
    copies = {item for items in copies_of(valves).values() for item in items}
    for number, (node, found) in enumerate(zip(wanted, looked, strict=True)):
        if found.fault is not None or found.node is None:
            faults[number] = f"{node.label} {found.fault}"
        elif node.item is None:
            kind = _variant_type(found.type)
            writable[node.valve, node.role] = WritableNode(found.node, kind, node.label)
        elif node.item not in copies:
            own = MonitoredNode(node.item, found.node, node.label, found.type, found.place)
            monitored.append(own)
    if faults and not (lenient and monitored):
        more = f" (and {len(faults) - 1} more nodes)" if len(faults) > 1 else ""
        raise SourceRejected(next(iter(faults.values())) + more)
    of_items = {item: said for n, said in faults.items() if (item := wanted[n].item) is not None}
    return CheckedNodes(tuple(monitored), writable, of_items, tuple(before or namespaces))


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


async def look(
    connection: Connection,
    wanted: Sequence[Wanted],
    namespaces: Sequence[str],
    before: Sequence[str] = (),
) -> list[Looked]:
    """Read nodes once; return what each is at the server; arguments as those of `check_nodes`.

    Raises
    ------
    SourceLost
    """
    url = connection.settings.url
    ids: list[ua.NodeId | str] = []
    for node in wanted:
        try:
            ids.append(_resolved(node.text, namespaces, before))
        except SourceRejected as error:
            ids.append(str(error))
    known = [one for one in ids if not isinstance(one, str)]
    with connection.errors("reading the nodes"):
        both = ua.TimestampsToReturn.Both
        answers = iter(await read_attributes(connection, known, _ATTRIBUTES, both))
        found = []
        for node, one in zip(wanted, ids, strict=True):
            if isinstance(one, str):
                found.append(Looked(None, one, ItemState.GONE))
                continue
            answer = next(answers)
            place = await _place(connection, node.part, answer)
            found.append(_looked(url, node, one, answer, place))
        return found


async def _place(
    connection: Connection, part: int | Path | None, answer: Sequence[ua.DataValue]
) -> int | Member | str | None:
    """Return where a part is found, or why there is none, as the end of a sentence."""
    _, data_type, _, _, value = answer
    if not isinstance(part, tuple):
        return part
    own = data_type.Value.Value if data_type.Value is not None else None
    return await member_of(connection, own, value.Value and value.Value.Value, part)


def _looked(
    url: str,
    node: Wanted,
    node_id: ua.NodeId,
    answer: Sequence[ua.DataValue],
    place: int | Member | str | None,
) -> Looked:
    _, data_type, _, _, value = answer
    fault, state = _fault(answer, place, write=node.item is None)
    if fault is None and node.role == HEARTBEAT and _type_of(answer) != ua.VariantType.UInt32:
        fault = f"is of type {_type_of(answer).name} at {{url}}; a UInt32 is needed"
    if fault is not None:
        return Looked(node_id, fault.format(url=url), state)
    stamped = value.SourceTimestamp
    time = utc_ns(stamped) if stamped is not None else 0
    kind = place.kind if isinstance(place, Member) else _kind(data_type, value)
    own = None if isinstance(place, str) else place
    return Looked(node_id, None, ItemState.GOOD, kind, _code(value), time, own)


def _resolved(text: str, namespaces: Sequence[str], before: Sequence[str]) -> ua.NodeId:
    """Parse a NodeId; an index denotes the namespace that it had in ``before``."""
    match = _NODE_ID.fullmatch(parted(text)[1])
    if match is not None and match["uri"] is not None and match["uri"] not in namespaces:
        raise SourceRejected(
            f"cannot be found: the server has no namespace {printable(match['uri'])}; it has "
            f"{in_one_line(', '.join(namespaces))}"
        )
    node = parse_node_id(text, namespaces)
    index = int(match["index"] or 0) if match is not None else 0
    if not index or index >= len(before) or list(namespaces[index : index + 1]) == [before[index]]:
        return node
    if before[index] not in namespaces:
        raise SourceRejected(
            f"has lost its namespace: ns={index} was {printable(before[index])}; the server has "
            f"{in_one_line(', '.join(namespaces))}"
        )
    return ua.NodeId(node.Identifier, list(namespaces).index(before[index]), node.NodeIdType)


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


def _uint32(text: str) -> int:
    number = int(text)
    if not 0 <= number < 2**32:
        raise ValueError(text)
    return number


def _fault(
    answer: Sequence[ua.DataValue], place: int | Member | str | None, *, write: bool
) -> tuple[str | None, ItemState]:
    """Return the fault of a node as the end of a sentence with ``{url}``, None if it has none."""
    node_class, data_type, rank, access, value = answer
    faults = (
        (_fault_of_class(node_class), ItemState.GONE),
        (_fault_of_access(access, value, write=write), ItemState.REFUSED),
        (_fault_of_type(data_type, rank, value, place), ItemState.WRONG_TYPE),
    )
    return next((one for one in faults if one[0] is not None), (None, ItemState.GOOD))


def _fault_of_class(node_class: ua.DataValue) -> str | None:
    code = _code(node_class)
    if code in {ua.StatusCodes.BadNodeIdUnknown, ua.StatusCodes.BadNodeIdInvalid}:
        return "does not exist at {url}; the NodeId of an existing variable is needed"
    if code >> 31:
        return f"cannot be read at {{url}}: {status_name(code)}"
    if node_class.Value.Value != ua.NodeClass.Variable:
        name = ua.NodeClass(node_class.Value.Value).name
        return f"is of class {name} at {{url}}; a Variable is needed"
    return None


def _fault_of_access(access: ua.DataValue, value: ua.DataValue, *, write: bool) -> str | None:
    bit, verb = (
        (ua.AccessLevel.CurrentWrite, "written") if write else (ua.AccessLevel.CurrentRead, "read")
    )
    withheld = not _code(access) >> 31 and not (access.Value.Value or 0) >> bit & 1
    denied = not write and _code(value) == ua.StatusCodes.BadUserAccessDenied
    if withheld or denied:
        return f"cannot be {verb} by this user at {{url}}; another user is needed"
    return None


def _fault_of_type(
    data_type: ua.DataValue,
    rank: ua.DataValue,
    value: ua.DataValue,
    place: int | Member | str | None,
) -> str | None:
    if isinstance(place, (str, Member)):
        return _braced(place) + " at {url}" if isinstance(place, str) else None
    kind = _kind(data_type, value)
    if kind is not None and kind not in NUMERIC_FORMATS and kind not in _ABSTRACT_NUMBERS:
        is_structure = kind == ua.VariantType.ExtensionObject
        wanted = "a member: member=<name>; before the NodeId" if is_structure else _NUMBERS
        return f"is of type {ua.VariantType(kind).name} at {{url}}; {wanted} is needed"
    is_array = value.Value is not None and value.Value.is_array
    if place is not None:
        return _fault_of_element(rank, value, place)
    if rank.Value.Value not in _SCALARS or is_array:
        some = f"index=0 to index={len(value.Value.Value) - 1}" if is_array else "index=0"
        return f"is an array at {{url}}; a scalar is needed, or {some}; before the NodeId"
    return None


def _braced(text: str) -> str:
    """Return a text as ``str.format`` gives it back."""
    return text.replace("{", "{{").replace("}", "}}")


def _fault_of_element(rank: ua.DataValue, value: ua.DataValue, element: int) -> str | None:
    if value.Value is None or value.Value.VariantType is ua.VariantType.Null:
        return None  # no value yet
    if not value.Value.is_array:
        return f"is no array at {{url}}; leave out index={element};"
    if (rank.Value.Value or 0) > 1 or len(value.Value.Dimensions or ()) > 1:
        return "is an array of several dimensions at {url}; one of a single dimension is needed"
    n = len(value.Value.Value)
    if element >= n:
        there = f"index=0 to index={n - 1} are there" if n else "it is empty"
        return f"has {n} elements at {{url}}, none with index={element}; {there}"
    return None


def _type_of(answer: Sequence[ua.DataValue]) -> ua.VariantType:
    _, data_type, _, _, value = answer
    return _variant_type(_kind(data_type, value))


def _variant_type(kind: int | None) -> ua.VariantType:
    return ua.VariantType(kind) if kind in NUMERIC_FORMATS else ua.VariantType.Double


def _kind(data_type: ua.DataValue, value: ua.DataValue) -> int | None:
    """Return the built-in type of a variable's values; None if it is not known yet."""
    if value.Value is not None and value.Value.VariantType != ua.VariantType.Null:
        return int(value.Value.VariantType.value)
    node_id = data_type.Value.Value if data_type.Value is not None else None
    if node_id is None or node_id.NamespaceIndex != 0:
        return None
    known = node_id.Identifier in _BUILT_IN | _ABSTRACT_NUMBERS and node_id.Identifier != 24
    return int(node_id.Identifier) if known else None


def _code(answer: ua.DataValue) -> int:
    return answer.StatusCode.value if answer.StatusCode is not None else 0
