"""NodeIds as they are written in a configuration, and as a server numbers them."""

import re
from collections.abc import Sequence
from uuid import UUID

from asyncua import ua

from valvemap.errors import ConfigurationError, SourceRejected
from valvemap.foreign_text import printable
from valvemap.opcua_client.source_errors import in_one_line
from valvemap.opcua_source.elements import parted

_NODE_ID = re.compile(
    r"(?:ns=(?P<index>\d{1,5});|nsu=(?P<uri>[^;]+);)?(?P<kind>[isgb])=(?P<name>.+)", re.DOTALL
)
_ALLOWED = (
    "allowed are [ns=<index>;|nsu=<uri>;]s=<text>, i=<number>, g=<guid> or b=<base64>; before it "
    "index=<number>; for an element of an array, or member=<name>.<name>; for a member of a "
    "structure"
)


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


def resolved_node_id(text: str, namespaces: Sequence[str], before: Sequence[str]) -> ua.NodeId:
    """Parse a NodeId; an index denotes the namespace that it had in ``before``.

    Raises
    ------
    SourceRejected
        if the server does not have the namespace; the message is the end of a sentence.
    """
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


def _uint32(text: str) -> int:
    number = int(text)
    if not 0 <= number < 2**32:
        raise ValueError(text)
    return number
