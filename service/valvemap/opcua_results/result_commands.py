"""Operator commands on valves: methods that change state, each recorded in LastAction."""

from collections.abc import Callable
from functools import partial
from typing import Any

from asyncua import ua

from guarded_opcua import Argument, Clock, OutOfRange, Role, add_method
from valvemap.opcua_results.answers import answered, say_nothing
from valvemap.opcua_results.information_model import ARMED, BASELINE, INVERSE
from valvemap.opcua_results.result_notes import ResultNotes
from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.opcua_results.result_types import Place
from valvemap.opcua_results.result_values import Shown, baseline_values
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.pipeline.ports import Answer, Operator


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

    async def add_to_estimator(
        self, place: Place, parent: ua.NodeId, valve: str, estimator: str
    ) -> None:
        """Add the commands of an estimator of a valve."""
        command = partial(self._add, place, parent, f"{valve}.{estimator}")
        who = (valve, estimator)
        await command(
            "Reset",
            partial(self._operator.reset, *who),
            "Reset the estimator: drop all that it has learnt.",
        )
        await command(
            "Freeze", partial(self._operator.freeze, *who), "Stop adaptation: predict only."
        )
        await command("Resume", partial(self._operator.resume, *who), "Resume adaptation.")
        await command(
            "SetForgettingFactor",
            partial(self._set_forgetting_factor, *who),
            "Set the forgetting factor from the next sample on; 1: all samples have equal weight.",
            Argument("ForgettingFactor", "0 < λ <= 1"),
        )

    async def add_to_inverse(self, place: Place, parent: ua.NodeId, valve: str) -> None:
        """Add the commands of a valve's inverse map: Arm and Disarm."""
        command = partial(self._add, place, parent, f"{valve}.{INVERSE}")
        await command(
            "Arm",
            partial(self._arm, valve),
            "Arm writing of RequiredU to the valve; a restart disarms it.",
        )
        await command(
            "Disarm",
            partial(self._disarm, valve),
            "Disarm: write nothing more to the valve; the source takes its own command.",
        )

    async def add_to_baseline(self, place: Place, parent: ua.NodeId, valve: str) -> None:
        """Add the commands of the baseline: Approve, RollBack and ValveReplaced."""
        command = partial(self._add, place, parent, f"{valve}.{BASELINE}")
        await command(
            "Approve",
            partial(self._approve, valve),
            "Approve the present map as the reference for later comparison.",
        )
        await command(
            "RollBack",
            partial(self._operator.roll_back, valve),
            "Restore all estimators to their states at the approval.",
        )
        await command(
            "ValveReplaced",
            partial(self._replace_valve, valve),
            "Declare the valve replaced: reset all estimators and drop the approved map.",
        )

    async def _add(
        self,
        place: Place,
        parent: ua.NodeId,
        prefix: str,
        name: str,
        function: Callable[..., Answer[None]],
        description: str,
        *inputs: Argument,
    ) -> None:
        valve, _, part = prefix.partition(".")

        def command(*arguments: Any) -> Answer[None]:  # noqa: ANN401 - the command's own
            given = "".join(f" {argument:g}" for argument in arguments)
            return answered(
                partial(function, *arguments),
                lambda _: self._notes.acted(valve, f"{part} {name}{given}"),
                partial(self._notes.refused, valve) if part == BASELINE else say_nothing,
            )

        await add_method(
            place,
            parent,
            f"{prefix}.{name}",
            command,
            inputs=inputs,
            required=Role.OPERATOR,
            description=description,
        )

    def _set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> Answer[None]:
        if not 0.0 < lam <= 1.0:
            raise OutOfRange(f"forgetting factor {lam:g}: allowed is 0 < λ <= 1")
        return self._operator.set_forgetting_factor(valve, estimator, lam)

    def _arm(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.arm, valve)
        return answered(asked, lambda _: self._show_armed(valve, armed=True))

    def _disarm(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.disarm, valve)
        return answered(asked, lambda _: self._show_armed(valve, armed=False))

    def _show_armed(self, valve: str, *, armed: bool) -> None:
        new = Shown(f"{INVERSE}.{ARMED}", armed, ua.StatusCodes.Good, self._clock.now())
        self._variables.show(valve, new)

    def _approve(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.approve, valve)
        return answered(asked, lambda _: self._show_baseline(valve))

    def _replace_valve(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.replace_valve, valve)
        return answered(asked, lambda _: self._show_baseline(valve))

    def _show_baseline(self, valve: str) -> None:
        found = self._operator.baseline(self._slots.number(valve))
        for new in baseline_values(found, self._clock.now()):
            self._variables.show(valve, new)
