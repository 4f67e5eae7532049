"""The nodes of valves: folders are created at once, their children on first access."""

from collections.abc import Callable, Collection
from functools import partial

from asyncua import ua

from guarded_opcua import HardenedServer, add_object, add_property
from valvemap.opcua_results.companions import Companions
from valvemap.opcua_results.information_model import ALARMS, NODE_VERSION, ROOT
from valvemap.opcua_results.model_changes import version_of_valve
from valvemap.opcua_results.process_values import ProcessValues
from valvemap.opcua_results.result_alarms import ResultAlarms
from valvemap.opcua_results.result_health import ResultHealth
from valvemap.opcua_results.result_parts import ResultParts
from valvemap.opcua_results.result_types import ESTIMATOR, VALVE, AddPart, type_of
from valvemap.pipeline.operator_ports import Operator
from valvemap.pipeline.results import ValveDescription


class ResultNodes:
    """Adds valves and removes them.

    Parameters
    ----------
    server, companions
        The server and its companion namespaces.
    parts
        Adds the variables and methods of each part of a valve.
    process_values
        Adds signals and demands once more, as Machinery has them.
    alarms, health
        Publish the alarms and the DeviceHealth of valves.
    operator
        Holds the state of alarms.
    is_heard_of
        Whether a result of a valve, given by its name, was published.
    keep_events
        Gives an object a history of its events.
    """

    def __init__(
        self,
        server: HardenedServer,
        companions: Companions,
        parts: ResultParts,
        process_values: ProcessValues,
        alarms: ResultAlarms,
        health: ResultHealth,
        operator: Operator,
        is_heard_of: Callable[[str], bool],
        keep_events: Callable[[ua.NodeId], None],
    ) -> None:
        self._server = server
        self._companions = companions
        self._parts = parts
        self._process_values = process_values
        self._alarms = alarms
        self._health = health
        self._operator = operator
        self._is_heard_of = is_heard_of
        self._keep_events = keep_events

    async def add(self, valve: ValveDescription) -> None:
        """Add the folder of a valve; its children are added on first access."""
        server = self._server
        folder = await add_object(
            server,
            ua.NodeId(ROOT, server.namespace_index),
            valve.name,
            description=f"The valve {valve.name} and its results.",
            type_definition=type_of(server, VALVE),
        )
        server.let_emit(folder)
        # before add_later: a later access would create the children at once
        self._keep_events(folder)
        self._companions.list_device(folder)
        server.add_later(folder, partial(self._add_below, folder, valve))

    def remove(self, names: Collection[str]) -> None:
        """Remove valves with all their child nodes."""
        index = self._server.namespace_index
        referrers = ua.NodeId(ROOT, index), self._companions.device_set
        self._server.remove([ua.NodeId(name, index) for name in names], referrers)
        for name in names:
            self._health.forget(name)

    async def _add_below(self, folder: ua.NodeId, valve: ValveDescription) -> None:
        """Add the children of a valve's folder; the children of its parts are added on access."""
        server, parts = self._server, self._parts
        server.refer_to_conditions(folder, self._alarms.keys(valve.name))
        await add_property(server, folder, NODE_VERSION, version_of_valve(valve))
        await self._companions.add_identification(folder, valve.nameplate)
        is_heard_of = self._is_heard_of(valve.name)
        self._health.add(
            valve.name,
            await self._companions.add_health(folder, "valve"),
            self._operator.alarms(valve.name) if is_heard_of else None,
        )
        await self._process_values.add(folder, valve)
        await parts.add_frame(server, folder, valve)
        add_part = partial(self._add_part, folder, valve)
        for estimator in valve.estimators:
            add_estimator = partial(parts.add_estimator, estimator)
            kind = type_of(server, ESTIMATOR)
            await add_part(estimator.name, estimator.description, add_estimator, kind)
        for name, (words, add) in parts.of_every_valve().items():
            await add_part(name, words, add, type_of(server, name) if name != ALARMS else None)

    async def _add_part(
        self,
        folder: ua.NodeId,
        valve: ValveDescription,
        name: str,
        description: str,
        add: AddPart,
        kind: ua.NodeId | None,
    ) -> None:
        part = await add_object(
            self._server,
            folder,
            f"{valve.name}.{name}",
            description=description,
            type_definition=kind,
        )
        self._server.add_later(part, partial(add, self._server, part, valve))
