"""A foreign server whose variables have any path, unit, range and type, and values of any law."""

from dataclasses import dataclass
from datetime import UTC, datetime

from asyncua import ua

from support.foreign import Foreign, information

CODES = {"bar": "BAR", "l/min": "L2", "%": "P1", "V": "VLT", "psi": "PS", "m3/h": "MQH"}


@dataclass(frozen=True)
class Tag:
    """A variable: its path, its value at t s, and its labels."""

    path: tuple[str, ...]
    value: object  # t -> number or list
    unit: str | None = None
    bounds: tuple[float, float] | None = None
    kind: ua.VariantType = ua.VariantType.Double


class Installation(Foreign):
    """Writes all tags with one stamp, 20 times per second."""

    def __init__(self, tags):
        super().__init__({}, tags)

    async def step(self, server, nodes, k):
        now = datetime.now(UTC)
        for node, tag in zip(nodes, self.folders, strict=True):
            value = ua.DataValue(self.variant(tag, k * 0.05), SourceTimestamp=now)
            await server.write_attribute_value(node.nodeid, value)

    @staticmethod
    def variant(tag, t):
        value = tag.value(t)
        if tag.kind is ua.VariantType.Double:
            return ua.Variant(value, tag.kind)
        return ua.Variant(round(value), tag.kind)

    async def add(self, server, index, tag):
        parent = server.nodes.objects
        for depth, name in enumerate(tag.path[:-1], 1):
            at = ua.NodeId("/".join(tag.path[:depth]), index)
            below = [child.nodeid for child in await parent.get_children()]
            known = at in below
            parent = server.get_node(at) if known else await parent.add_object(at, name)
        node = await parent.add_variable(
            ua.NodeId("/".join(tag.path), index), tag.path[-1], self.variant(tag, 0.0)
        )
        if tag.unit is not None:
            await node.add_property(0, "EngineeringUnits", information(CODES[tag.unit], tag.unit))
        if tag.bounds is not None:
            await node.add_property(0, "EURange", ua.Range(*tag.bounds))
        return node
