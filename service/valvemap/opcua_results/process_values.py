"""Signals and demands of valves as Process Values of Machinery (OPC 40001-2).

Each has an AnalogSignal of PA-DIM with unit and range: another node for the value of a variable of
the service, whose own node does not change.
"""

from collections.abc import Iterator
from functools import partial
from typing import Final

from asyncua import ua

from guarded_opcua import HardenedServer, add_object, add_property, add_variable
from valvemap.opcua_results.companions import Companions
from valvemap.opcua_results.information_model import (
    INVERSE,
    PROCESS_VALUES,
    VariableNode,
    signal_variables,
)
from valvemap.opcua_results.map_variables import inverse_variables
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.pipeline.results import ValveDescription

_SIGNAL_VARIABLE: Final = 1111  # AnalogSignalVariableType, of PA-DIM
_PROCESS_VALUE: Final = 1003  # ProcessValueType
_OF_INVERSE: Final = ("FlowDemand", "PressureDrop", "RequiredU")


class ProcessValues:
    """Adds the process values of valves on first access.

    Parameters
    ----------
    server, companions
        The server and its companion namespaces.
    variables
        Holds the variables whose values they show.
    """

    def __init__(
        self, server: HardenedServer, companions: Companions, variables: ResultVariables
    ) -> None:
        self._server = server
        self._companions = companions
        self._variables = variables

    async def add(self, folder: ua.NodeId, valve: ValveDescription) -> None:
        """Add the folder of a valve's process values."""
        own = await add_object(
            self._server,
            folder,
            f"{folder.Identifier}.{PROCESS_VALUES}",
            description="Signals and demands as Process Values of Machinery.",
            type_definition=ua.NodeId(ua.ObjectIds.FolderType),
        )
        self._server.add_later(own, partial(self._add_below, own, valve))

    async def _add_below(self, parent: ua.NodeId, valve: ValveDescription) -> None:
        for node in process_variables(valve):
            await self._add_one(parent, node)

    async def _add_one(self, parent: ua.NodeId, node: VariableNode) -> None:
        server, padim = self._server, self._companions.padim
        assert node.unit is not None  # noqa: S101 - see process_variables
        own = await add_object(
            server,
            parent,
            f"{parent.Identifier}.{node.id.rpartition('.')[2]}",
            description=node.description,
            type_definition=ua.NodeId(_PROCESS_VALUE, self._companions.process_values),
        )
        await add_property(
            server, own, ua.QualifiedName("SignalTag", padim), node.id, description="Tag."
        )
        shown = await add_variable(
            server,
            own,
            f"{own.Identifier}.AnalogSignal",
            None,
            description=f"The value of {node.id}.",
            unit=node.unit,
            value_range=node.range,
            type_definition=ua.NodeId(_SIGNAL_VARIABLE, padim),
            name=ua.QualifiedName("AnalogSignal", padim),
        )
        server.show_also(shown, self._variables.made(node.id))


def process_variables(valve: ValveDescription) -> Iterator[VariableNode]:
    """The variables that are process values: the signals, and demand and answer of the inverse."""
    yield from signal_variables(valve)
    wanted = {f"{valve.name}.{INVERSE}.{name}" for name in _OF_INVERSE}
    yield from (node for node in inverse_variables(valve) if node.id in wanted)
