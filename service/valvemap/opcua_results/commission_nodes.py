"""The nodes of commissioning runs: methods, State, Progress, and the operator's heartbeat."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final

from asyncua import ua

from guarded_opcua import (
    Argument,
    HardenedServer,
    Role,
    Unit,
    Variable,
    add_method,
    add_object,
    caller,
)
from valvemap.clock import Clock
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.information_model import COMMISSION, VariableNode, sentences_of
from valvemap.opcua_results.result_variables import add_described
from valvemap.pipeline.commission_ports import CommissionOperator, CommissionResults
from valvemap.pipeline.operator_ports import Answer
from valvemap.vocabulary.commission import Phase

_HEARTBEAT: Final = "Heartbeat"
_START: Final = (
    "Start a run: U is written to the valve, and the load's set point where there is one, within "
    f"the limits of [valves.commission]. Write {_HEARTBEAT} at even intervals of .4 s or less "
    "until the end; where one is late, U returns to its safe value. Refused while feed-forward is "
    "armed."
)
_RESUME: Final = (
    "Continue the last run where it was interrupted, with what it had learnt; otherwise as Start."
)
_TEXT: Final = ua.VariantType.String
_LONGEST_S: Final = 3_600.0
_MOST_FLOW: Final = 10_000.0  # l/min; more than any valve passes


class CommissionNodes:
    """Adds the nodes of runs to valves that can be driven, and writes them.

    Parameters
    ----------
    server
        The server that shows them.
    clock
        Time of the values.
    """

    def __init__(self, server: HardenedServer, clock: Clock) -> None:
        self._server = server
        self._clock = clock
        self._variables: dict[str, Variable] = {}
        self._valves: tuple[str, ...] = ()

    async def follow(self, valves: Sequence[str], operator: CommissionOperator) -> None:
        """Show runs of these valves, in place of those before."""
        server = self._server
        for valve in self._valves:
            own = ua.NodeId(f"{valve}.{COMMISSION}", server.namespace_index)
            if own in server.address_space:
                server.remove([own], (ua.NodeId(valve, server.namespace_index),))
        self._variables.clear()
        self._valves = tuple(valves)
        for valve in valves:
            await self._add(valve, operator)
            self.show(valve, CommissionResults())

    def show(self, valve: str, results: CommissionResults) -> None:
        """Write how the run of one valve stands."""
        t, good = self._clock.now(), int(ua.StatusCodes.Good)
        self._server.write(
            (self._variables[f"{valve}.{COMMISSION}.{name}"], value, good, t)
            for name, value in _values(results)
            if f"{valve}.{COMMISSION}.{name}" in self._variables
        )

    async def _add(self, valve: str, operator: CommissionOperator) -> None:
        server = self._server
        folder = ua.NodeId(valve, server.namespace_index)
        words = "Drives the valve through its range until its map is known, within limits."
        parent = await add_object(server, folder, f"{valve}.{COMMISSION}", description=words)
        beat = partial(_beat, operator, valve)
        for node in commission_variables(valve):
            on_write: Callable[[float], Answer[None]] | None = beat if node.writable else None
            value = 0.0 if node.writable else None
            variable = await add_described(server, parent, node, value, on_write)
            if not node.writable:
                self._variables[node.id] = variable
        prefix = f"{valve}.{COMMISSION}"
        accuracy = Argument(
            "Accuracy",
            "End when the map's 95 % interval is ± this or less; 0 uses the whole time",
            unit=Unit.LITRE_PER_MINUTE,
            value_range=(0.0, _MOST_FLOW),
        )
        for name, begin, words in (
            ("Start", operator.start_commission, _START),
            ("Resume", operator.resume_commission, _RESUME),
        ):
            await add_method(
                server,
                parent,
                f"{prefix}.{name}",
                partial(_begin, begin, valve),
                inputs=(accuracy,),
                required=Role.OPERATOR,
                description=words,
            )
        await add_method(
            server,
            parent,
            f"{prefix}.Abort",
            partial(_abort, operator, valve),
            required=Role.OPERATOR,
            description="Return to the safe U, then hand the valve back.",
        )


def commission_variables(valve: str) -> Iterator[VariableNode]:
    """Yield the variables of a valve's runs."""
    prefix = f"{valve}.{COMMISSION}"
    yield VariableNode(
        f"{prefix}.State",
        f"State of the run. {sentences_of(Phase)}",
        ua.VariantType.Int32,
        statuses=Phase,
    )
    yield VariableNode(f"{prefix}.Reason", "Cause of a pause or an end, in words.", _TEXT)
    yield VariableNode(
        f"{prefix}.Progress",
        "The run in words: phase, time left, uncertainty of the map, U.",
        _TEXT,
    )
    yield VariableNode(
        f"{prefix}.TimeLeft",
        "Longest time until the end of the run.",
        unit=Unit.SECOND,
        range=(0.0, _LONGEST_S),
    )
    yield VariableNode(
        f"{prefix}.MapStd",
        "Standard deviation of the map that the run has learnt, mean over U; NaN before it.",
        unit=Unit.LITRE_PER_MINUTE,
        range=(0.0, _MOST_FLOW),
    )
    yield VariableNode(f"{prefix}.Recording", "The file with the samples of the run.", _TEXT)
    yield VariableNode(
        f"{prefix}.{_HEARTBEAT}",
        "Any number, written at even intervals of .4 s or less: the operator is there.",
        range=(0.0, 4_294_967_295.0),
        writable=True,
    )


def _values(results: CommissionResults) -> Iterator[tuple[str, Any]]:
    yield "State", int(results.phase)
    yield "Reason", results.reason
    yield "Progress", results.progress
    yield "TimeLeft", results.time_left
    yield "MapStd", results.map_std
    yield "Recording", results.recording


def _begin(begin: Callable[[str, float, str], None], valve: str, accuracy: float) -> Answer[None]:
    return answered(partial(begin, valve, accuracy, str(caller())), _nothing)


def _abort(operator: CommissionOperator, valve: str) -> Answer[None]:
    return answered(partial(operator.abort_commission, valve), _nothing)


def _beat(operator: CommissionOperator, valve: str, _: float) -> Answer[None]:
    return answered(partial(operator.note_operator, valve), _nothing)


def _nothing(_: None) -> None:
    return None
