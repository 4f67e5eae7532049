"""The variables of the results server, by id; values are cached until the node exists."""

from collections.abc import Callable, Collection, Iterable
from typing import Any

from asyncua import ua

from guarded_opcua import HardenedServer, Role, Variable, add_variable
from valvemap.opcua_results.information_model import TYPES, VariableNode
from valvemap.opcua_results.past import ResultsPast, has_past
from valvemap.opcua_results.result_blocks import Generations
from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.opcua_results.result_types import Place
from valvemap.opcua_results.result_values import Shown
from valvemap.pipeline.operator_ports import Answer
from valvemap.vocabulary.edges import split_id
from valvemap.vocabulary.statuses import Described


class ResultVariables:
    """Adds variables and writes them; values of variables without a node are cached.

    Parameters
    ----------
    server
        The server that shows them.
    slots
        The valves that are shown.
    blocks
        Hold the values that change with each result.
    past
        The history of variables; None: no history.
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
        self._waiting: dict[str, Shown] = {}  # latest values without a node

    async def add(
        self,
        place: Place,
        parent: ua.NodeId,
        node: VariableNode,
        value: Any,  # noqa: ANN401 - as the variable's type says
        on_write: Callable[[float], Answer[None]] | None = None,
        type_definition: ua.NodeId | None = None,
    ) -> Variable:
        """Add a variable with its latest value, or ``value`` if none was published.

        Parameters
        ----------
        place, parent
            The server or type declaration, and the parent node.
        node
            The description of the variable.
        value
            The initial value; None: BadWaitingForInitialData until the first value.
        on_write
            Called with the value that a client writes, in the variable's unit.
        type_definition
            None: BaseDataVariableType.
        """
        variable = await add_described(place, parent, node, value, on_write, type_definition)
        self._added[node.id] = variable
        if self._past is not None and has_past(node.id):
            place.add_history([variable], self._past)
        owner, name = split_id(node.id)
        if node.id in self._waiting:
            self.show(owner, self._waiting.pop(node.id))
        slot = self._slots.by_name.get(owner)
        if slot is not None:
            self._blocks.show(slot, name, variable)
        return variable

    def made(self, id_: str) -> Variable:
        """Return a variable, and make its node if it was not accessed yet."""
        at = ua.NodeId(id_, self._server.namespace_index)
        assert at in self._server.address_space, id_  # noqa: S101 - this makes it
        return self._added[id_]

    async def add_standing(self, parent: ua.NodeId, node: VariableNode, now: Shown) -> None:
        """Add a variable with the value ``now``, unless a newer value is cached."""
        self._waiting.setdefault(node.id, now)
        await self.add(self._server, parent, node, None)

    def show(self, owner: str, new: Shown) -> None:
        """Write a variable of a valve or of the service; cache the value if it has no node."""
        id_ = f"{owner}.{new.name}"
        variable = self._added.get(id_)
        if variable is None:
            self._waiting[id_] = new
        else:
            self._server.write([(variable, new.value, new.code, new.t)])

    def write(self, values: Iterable[tuple[str, Any, int]], t: int) -> None:
        """Write variables that have nodes, each given as id, value and StatusCode.

        ``t`` (UTC ns) is the source time of all.
        """
        self._server.write((self._added[id_], value, code, t) for id_, value, code in values)

    def forget(self, valves: Collection[str]) -> None:
        """Drop the variables of these valves: their nodes were removed."""
        for known in (self._added, self._waiting):
            for id_ in [id_ for id_ in known if split_id(id_)[0] in valves]:
                del known[id_]


def enumeration_of(place: Place, kind: type[Described]) -> ua.NodeId:
    """Return the DataType of an enumeration."""
    return ua.NodeId(f"{TYPES}.{kind.__name__}", place.namespace_index)


async def add_described(
    place: Place,
    parent: ua.NodeId,
    node: VariableNode,
    value: Any,  # noqa: ANN401 - as the variable's type says
    on_write: Callable[[float], Answer[None]] | None = None,
    type_definition: ua.NodeId | None = None,
) -> Variable:
    """Add a variable as its description says; arguments as those of `ResultVariables.add`."""
    return await add_variable(
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
        or_nan=node.writable,  # NaN withdraws a demand
        type_definition=type_definition,
        data_type=None if node.statuses is None else enumeration_of(place, node.statuses),
    )
