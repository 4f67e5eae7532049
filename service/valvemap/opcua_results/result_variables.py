"""The variables of the results server, by id: what is new of each waits for its node."""

from collections.abc import Callable, Collection, Iterable
from typing import Any

from asyncua import ua

from guarded_opcua import HardenedServer, Role, Variable, add_variable
from valvemap.opcua_results.information_model import VariableNode
from valvemap.opcua_results.past import ResultsPast, has_past
from valvemap.opcua_results.result_blocks import Generations
from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.opcua_results.result_types import Place
from valvemap.opcua_results.result_values import Shown
from valvemap.pipeline.ports import Answer


class ResultVariables:
    """Adds variables and writes them, whether they have a node yet or not.

    Parameters
    ----------
    server
        Where.
    slots
        Which valves are shown.
    blocks
        Where stands what changes with each result.
    past
        What variables have been; None: that cannot be asked.
    """

    def __init__(
        self,
        server: HardenedServer,
        slots: ValveSlots,
        blocks: Generations,
        past: ResultsPast | None,
    ) -> None:
        self._server = server
        self._slots = slots
        self._blocks = blocks
        self._past = past
        self._added: dict[str, Variable] = {}
        self._waiting: dict[str, Shown] = {}  # the newest of what has no node yet

    async def add(
        self,
        place: Place,
        parent: ua.NodeId,
        node: VariableNode,
        value: Any,  # noqa: ANN401 - as the variable's type says
        on_write: Callable[[float], Answer[None]] | None = None,
        type_definition: ua.NodeId | None = None,
    ) -> Variable:
        """Add a variable that shows what is newest of it; ``value`` where nothing came yet.

        Parameters
        ----------
        place, parent
            Where.
        node
            What it is.
        value
            Of its type; None: it waits for its first.
        on_write
            Takes what a client writes, in the variable's unit.
        type_definition
            None: the standard's type of all data.
        """
        variable = await add_variable(
            place,
            parent,
            node.id,
            value,
            description=node.description,
            type=node.kind,
            unit=node.unit,
            value_range=node.range,
            dimensions=node.dimensions,
            enum_strings=node.enum_strings,
            writable_by=Role.OPERATOR if node.writable else None,
            on_write=on_write,
            or_nan=node.writable,  # NaN takes a demand back
            type_definition=type_definition,
        )
        self._added[node.id] = variable
        if self._past is not None and has_past(node.id):
            place.add_history([variable], self._past)
        owner, _, name = node.id.partition(".")
        if node.id in self._waiting:
            self.show(owner, self._waiting.pop(node.id))
        slot = self._slots.find(owner)
        if slot is not None:
            self._blocks.show(slot, name, variable)
        return variable

    async def add_standing(self, parent: ua.NodeId, node: VariableNode, now: Shown) -> None:
        """Add a variable that shows how something stands, unless something newer came."""
        self._waiting.setdefault(node.id, now)
        await self.add(self._server, parent, node, None)

    def show(self, owner: str, new: Shown) -> None:
        """Write a variable of a valve, or of the service; or keep it until there is a node."""
        id_ = f"{owner}.{new.name}"
        variable = self._added.get(id_)
        if variable is None:
            self._waiting[id_] = new
        else:
            self._server.write([(variable, new.value, new.code, new.t)])

    def write(self, values: Iterable[tuple[str, Any, int]], t: int) -> None:
        """Write variables that have nodes: id, value and StatusCode of each, all of one time.

        ``t`` is in UTC ns.
        """
        self._server.write((self._added[id_], value, code, t) for id_, value, code in values)

    def forget(self, valves: Collection[str]) -> None:
        """Know no more of these valves: their nodes are gone."""
        for known in (self._added, self._waiting):
            for id_ in [id_ for id_ in known if id_.partition(".")[0] in valves]:
                del known[id_]
