"""The page of the address space, generated from a running server."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

from asyncua import Client, ua
from asyncua.common.node import Node

from documentation.tables import table
from guarded_opcua import ServerSettings
from valvemap.app.build import build_identification
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI
from valvemap.config.models import Config
from valvemap.config.nameplate import IdentificationConfig
from valvemap.config.valves import ValveConfig
from valvemap.opcua_results.information_model import PROCESS_VALUES
from valvemap.opcua_results.map_variables import line_variables
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.results import ValveDescription

_HEAD = """# Address space

Namespace `{namespace}`; everything lies below `Objects/Identification`. A NodeId is
`s=<Valve>.<Estimator>.<Variable>`, and the browse path has the same names. `<Valve>` is a valve's
name in the configuration, `<Estimator>` one of {estimators} unless others are configured. *(of …)*
names those that have a node where not all do. Ids and paths never change. Below each
`s=<Valve>.Alarms.<Alarm>.Condition` lies what Part 9 has of its type, see [alarms](../alarms.md).
`Identification` and `DeviceHealth` have BrowseNames of Devices and Machinery, and the valves are
below `Objects/DeviceSet` as well, and `ProcessValues` shows signals and demands once more, see
[devices](../devices.md).

A result's SourceTimestamp is that of the sample behind it. A result is Uncertain if the samples do
not determine it well (excitation), Bad if a sensor is lost; a stale value is never Good. Without a
sample for `alignment.stale_after_s` (default 2 s), results are Bad.

`Predict`, `PredictMeasurement`, `Invert` and `Compare` need the role Observer. All other methods
and the writable variables need the role Operator.
"""


INVERSE_OF_A_VALVE = "<Valve>.Inverse"
_OF_LINES = """## `<Valve>.LineA`, `<Valve>.LineB`

A [valve with ports](../ports.md) has its edges as `<Valve>.PA`, `<Valve>.AT`, `<Valve>.PB` and
`<Valve>.BT`, each with all nodes of a valve, and its lines with these beside them.
"""


@dataclass
class _Row:
    """One variable or method, and the estimators that have it."""

    kind: str
    unit: str
    writable: bool
    description: str
    estimators: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Found:
    """One node of a server."""

    id: str
    kind: str
    unit: str
    writable: bool
    description: str


def address_space_page() -> str:
    """Return the page with all nodes of a service with the default configuration."""
    plate = dict.fromkeys(IdentificationConfig.model_fields, "urn:known")
    config = Config(valves=(ValveConfig(identification=IdentificationConfig(**plate)),))
    found = asyncio.run(nodes(config))
    (valve,) = config.valves
    estimators = [estimator.name for estimator in valve.estimators]
    tables: dict[str, dict[str, _Row]] = {}
    for one in found:
        owner, _, name = one.id.rpartition(".")
        owner, who = _general(owner, valve.name, estimators)
        row = tables.setdefault(owner, {}).setdefault(
            name, _Row(one.kind, one.unit, one.writable, one.description)
        )
        row.estimators += who
    parts = [_HEAD.format(namespace=NAMESPACE, estimators=", ".join(estimators))]
    for owner, rows in tables.items():
        parts.append(f"## `{owner}`\n")
        shown = [
            [
                f"`.{name}`{_of(row.estimators, estimators)}",
                row.kind + (" (written by an operator)" if row.writable else ""),
                row.unit,
                row.description,
            ]
            for name, row in rows.items()
        ]
        parts.append(table(["node", "type", "unit", "meaning"], shown) + "\n")
        if owner == INVERSE_OF_A_VALVE:
            parts += [_OF_LINES, _lines() + "\n"]
    return "\n".join(parts)


def _lines() -> str:
    """Return the variables that a line of a valve with ports has beside others."""
    line = ValveDescription(name="V.LineA", estimators=(), is_line=True)
    rows = [
        [
            f"`.{node.id.removeprefix('V.LineA.')}`",
            f"`{node.kind.name}`",
            "" if node.unit is None else str(node.unit.information.DisplayName.Text),
            node.description,
        ]
        for node in line_variables(line)
    ]
    return table(["node", "type", "unit", "meaning"], rows)


async def nodes(config: Config) -> list[Found]:
    """Return all variables and methods of a service with this configuration, by browsing."""
    identification = build_identification(config)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/service/",
        application_uri=APPLICATION_URI,
        application_name=APPLICATION_NAME,
        namespace_uri=APPLICATION_URI,
        none_on_loopback=True,
    )
    server = ResultsServer(settings, identification.descriptions(), identification)
    async with server, Client(server.url) as client:
        index = await client.get_namespace_index(NAMESPACE)
        root = client.get_node(ua.NodeId("Identification", index))
        return [one async for one in _below(root, index)]


async def _below(node: Node, index: int) -> AsyncIterator[Found]:
    for reference in await node.get_references(
        ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward
    ):
        if reference.NodeId.NamespaceIndex != index:
            continue
        if reference.BrowseName.NamespaceIndex == 0:
            continue  # standard nodes, such as a condition's, which Part 9 defines
        if reference.BrowseName.Name == PROCESS_VALUES:
            continue  # other nodes of the same variables
        child = Node(node.session, ua.NodeId(reference.NodeId.Identifier, index))
        match reference.NodeClass:
            case ua.NodeClass.Variable:
                yield await _variable(child)
            case ua.NodeClass.Method:
                yield await _method(child)
            case _:
                async for one in _below(child, index):
                    yield one


async def _variable(node: Node) -> Found:
    type_, rank, description, access = (
        one.Value.Value
        for one in await node.read_attributes(
            [
                ua.AttributeIds.DataType,
                ua.AttributeIds.ValueRank,
                ua.AttributeIds.Description,
                ua.AttributeIds.AccessLevel,
            ]
        )
    )
    name = (await Node(node.session, type_).read_browse_name()).Name
    kind = f"`{name}{'[]' * max(rank, 0)}`"
    writable = bool(access & ua.AccessLevel.CurrentWrite.mask)
    return Found(_id(node), kind, await _unit(node), writable, description.Text or "")


async def _method(node: Node) -> Found:
    description = await node.read_attribute(ua.AttributeIds.Description)
    sides = [await _arguments(node, name) for name in ("InputArguments", "OutputArguments")]
    kind = f"method ({sides[0]})" + (f" → {sides[1]}" if sides[1] else "")
    return Found(_id(node), kind, "", False, description.Value.Value.Text or "")  # noqa: FBT003


async def _arguments(node: Node, name: str) -> str:
    properties = {(await one.read_browse_name()).Name: one for one in await node.get_properties()}
    if name not in properties:
        return ""
    return ", ".join(argument.Name for argument in await properties[name].read_value())


async def _unit(node: Node) -> str:
    for one in await node.get_properties():
        if (await one.read_browse_name()).Name == "EngineeringUnits":
            return str((await one.read_value()).DisplayName.Text)
    return ""


def _id(node: Node) -> str:
    return str(node.nodeid.Identifier)


def _general(owner: str, valve: str, estimators: list[str]) -> tuple[str, list[str]]:
    """Return the owner with placeholders for valve and estimator, and the estimator."""
    first, *rest = owner.split(".")
    if first != valve:
        return owner, []
    who = [rest[0]] if rest and rest[0] in estimators else []
    return ".".join(["<Valve>", *("<Estimator>" for _ in who), *rest[len(who) :]]), who


def _of(who: list[str], estimators: list[str]) -> str:
    return "" if not who or who == estimators else f" *(of {', '.join(who)})*"
