"""Operator commands on valves: methods that change state, each recorded in LastAction."""

from collections.abc import Callable, Iterable
from functools import partial

from asyncua import ua

from guarded_opcua import Argument, Clock, OutOfRange, Role, add_method
from valvemap.opcua_results.answers import answered, say_nothing
from valvemap.opcua_results.information_model import ARMED, INVERSE
from valvemap.opcua_results.result_notes import ResultNotes
from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.opcua_results.result_types import Place
from valvemap.opcua_results.result_values import Shown, baseline_values
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.pipeline.operator_ports import Answer, Command, Operator
from valvemap.vocabulary.commands import Action, Effect, Subject, actions_on


class ResultCommands:
    """Adds command methods; their effects are published before the call returns.

    Parameters
    ----------
    operator
        Carries out the commands.
    slots
        The valves that are shown.
    variables
        Publish the changed values.
    notes
        Record actions and rejections.
    clock
        Source time of the changed values.
    """

    def __init__(
        self,
        operator: Operator,
        slots: ValveSlots,
        variables: ResultVariables,
        notes: ResultNotes,
        clock: Clock,
    ) -> None:
        self._operator = operator
        self._slots = slots
        self._variables = variables
        self._notes = notes
        self._clock = clock

    async def add(
        self, place: Place, parent: ua.NodeId, subject: Subject, valve: str, part: str
    ) -> None:
        """Add the methods of all commands on a subject: ``part`` of a valve."""
        for action in actions_on(subject):
            await add_method(
                place,
                parent,
                f"{valve}.{part}.{action.method}",
                partial(self._do, action, valve, part),
                inputs=[Argument(given.name, given.meaning) for given in action.inputs],
                required=Role.OPERATOR,
                description=action.sentence,
            )

    def _do(self, action: Action, valve: str, part: str, *values: float) -> Answer[None]:
        for given, value in zip(action.inputs, values, strict=True):
            if not given.above < value <= given.up_to:
                raise OutOfRange(f"{given.name} {value:g}: allowed is {given.meaning}")
        estimator = part if action.on is Subject.ESTIMATOR else ""
        command = Command(action.name, valve, estimator, values)

        def done(_: None) -> None:
            for new in self._changed(action.effect, valve):
                self._variables.show(valve, new)
            said = "".join(f" {value:g}" for value in values)
            self._notes.acted(valve, f"{part} {action.method}{said}")

        refused: Callable[[str], None] = say_nothing
        if action.on is Subject.BASELINE:
            refused = partial(self._notes.refused, valve)
        return answered(partial(self._operator.do, command), done, refused)

    def _changed(self, effect: Effect, valve: str) -> Iterable[Shown]:
        now = self._clock.now()
        match effect:
            case Effect.ARMED | Effect.DISARMED:
                armed = effect is Effect.ARMED
                return [Shown(f"{INVERSE}.{ARMED}", armed, ua.StatusCodes.Good, now)]
            case Effect.BASELINE:
                return baseline_values(self._operator.baseline(self._slots.number(valve)), now)
            case _:
                return ()
