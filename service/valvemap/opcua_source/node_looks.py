"""The state of nodes at a source server: existence, access, type and newest value of each."""

from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import ua

from valvemap.clock import utc_ns
from valvemap.errors import SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import read_attributes
from valvemap.opcua_client.source_errors import status_name
from valvemap.opcua_source.members import Member
from valvemap.opcua_source.node_ids import resolved_node_id
from valvemap.opcua_source.source_nodes import HEARTBEAT, Wanted
from valvemap.opcua_source.structures import Path
from valvemap.opcua_source.type_definitions import member_of
from valvemap.opcua_source.wire import NUMERIC_FORMATS
from valvemap.vocabulary.item_states import ItemState

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


async def look(
    connection: Connection,
    wanted: Sequence[Wanted],
    namespaces: Sequence[str],
    before: Sequence[str] = (),
) -> list[Looked]:
    """Read nodes once; return the state of each at the server; ``before`` as in `check_nodes`.

    Raises
    ------
    SourceLost
    """
    url = connection.settings.url
    ids: list[ua.NodeId | str] = []
    for node in wanted:
        try:
            ids.append(resolved_node_id(node.text, namespaces, before))
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
    return variant_type(_kind(data_type, value))


def variant_type(kind: int | None) -> ua.VariantType:
    """Return the type in which a number is written; Double for one of an abstract type."""
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
