"""Writes commands to nodes of the source, in the units that they have there."""

from collections.abc import Mapping, Sequence

from asyncua import ua

from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.source_errors import status_name
from valvemap.opcua_source.checked_nodes import WritableNode
from valvemap.opcua_source.source_nodes import HEARTBEAT, ValveNodes

_FLOATS = {ua.VariantType.Float, ua.VariantType.Double}


async def write_to_nodes(
    connection: Connection,
    valves: Sequence[ValveNodes],
    writable: Mapping[tuple[int, str], WritableNode],
    valve: int,
    commands: Mapping[str, float],
) -> dict[str, str]:
    """Write commands as `OpcUaSource.write_commands` does; ``writable`` by valve and role."""
    own = {role: writable.get((valve, role)) for role in commands}
    targets = {role: target for role, target in own.items() if target is not None}
    refused = {
        role: f"valve {valves[valve].valve} has no node {role}"
        for role in commands.keys() - targets
    }
    if not targets:
        return refused
    labels = ", ".join(target.label for target in targets.values())
    values = [_value(valves[valve], role, commands[role], of) for role, of in targets.items()]
    with connection.errors(f"writing {labels}"):
        answers = await connection.session.write(ua.WriteParameters(NodesToWrite=values))
    for (role, target), status in zip(targets.items(), answers, strict=True):
        if not status.is_good():
            refused[role] = (
                f"{target.label} does not take {commands[role]:g} at {connection.settings.url}: "
                f"{status_name(status.value)}"
            )
    return refused


def _value(nodes: ValveNodes, role: str, number: float, target: WritableNode) -> ua.WriteValue:
    if role != HEARTBEAT:
        number = nodes.measure(role).scaling(role).back(float(number))
    value = round(number) if target.type not in _FLOATS else number
    return ua.WriteValue(
        NodeId=target.node,
        AttributeId=ua.AttributeIds.Value,
        Value=ua.DataValue(ua.Variant(value, target.type), StatusCode=None),
    )
