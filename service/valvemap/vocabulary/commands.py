"""The commands of operators: one row each, from which methods, fleet messages and logs are made.

A command is carried out by the method of its name in the pipeline's part for its subject; see
:meth:`valvemap.pipeline.identification.Identification.do`.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Final


class Subject(Enum):
    """What a command acts on, beside the valve."""

    ESTIMATOR = "an estimator"
    BASELINE = "the approved map"
    INVERSE = "the inverse map"
    ALARM = "an alarm"
    """Its node is that of a condition, see `opcua_results.result_alarms`."""
    DEMAND = "the standing demand"
    """It is written as variables, see `opcua_results.result_demands`."""


class Effect(Enum):
    """The results published before the call returns, instead of with the next results."""

    NONE = "nothing"
    BASELINE = "the approved map's data"
    ARMED = "Armed: true"
    DISARMED = "Armed: false"


@dataclass(frozen=True)
class Input:
    """A number that a command takes: ``above`` < number <= ``up_to``."""

    name: str
    meaning: str
    above: float
    up_to: float


@dataclass(frozen=True)
class Action:
    """One command.

    Attributes
    ----------
    name
        In messages; also the name of the method that carries it out.
    method
        The OPC UA method, and its name in ``LastAction``.
    on
        Subject of the command.
    sentence
        For the operator.
    inputs
        The method's arguments.
    values
        Number of numbers in a fleet's message.
    effect
        Values published immediately.
    in_fleet
        Whether a fleet carries it out.
    variables
        Names of the variables that give it when they are written, in place of a method.
    by_mqtt
        Whether the configuration may allow it to MQTT clients.
    """

    name: str
    method: str
    on: Subject
    sentence: str
    inputs: tuple[Input, ...] = ()
    values: int = 0
    effect: Effect = Effect.NONE
    in_fleet: bool = True
    variables: tuple[str, ...] = ()
    by_mqtt: bool = False


_LAM = Input("ForgettingFactor", "0 < λ <= 1", 0.0, 1.0)

ACTIONS: Final = (
    Action(
        "reset",
        "Reset",
        Subject.ESTIMATOR,
        "Reset the estimator: drop all that it has learnt. A failed estimator starts again; Freeze "
        "and the forgetting factor remain.",
    ),
    Action(
        "freeze",
        "Freeze",
        Subject.ESTIMATOR,
        "Stop adaptation: the estimator learns nothing until Resume. Predictions, residuals and "
        "RequiredU continue with the present map. Alarms continue, too, but Changed and LagFound, "
        "which need learning, are not raised. It survives a restart and Reset.",
    ),
    Action("resume", "Resume", Subject.ESTIMATOR, "End Freeze: learn from the next sample on."),
    Action(
        "set_forgetting_factor",
        "SetForgettingFactor",
        Subject.ESTIMATOR,
        "Set the forgetting factor from the next sample on; 1: all samples have equal weight.",
        inputs=(_LAM,),
        values=1,
    ),
    Action(
        "demand",
        "demand",
        Subject.DEMAND,
        "Set flow and pressure drop.",
        values=2,
        variables=("FlowDemand", "PressureDrop"),
        by_mqtt=True,
    ),
    Action(
        "approve",
        "Approve",
        Subject.BASELINE,
        "Approve the present maps of all estimators as the reference for later comparison.",
        effect=Effect.BASELINE,
    ),
    Action(
        "roll_back",
        "RollBack",
        Subject.BASELINE,
        "Restore all estimators to their states at the approval. Failed estimators start again; "
        "Freeze and the forgetting factors remain.",
    ),
    Action(
        "replace_valve",
        "ValveReplaced",
        Subject.BASELINE,
        "Declare the valve replaced: reset all estimators and drop the approved map. Armed, the "
        "demand and Freeze remain: feed-forward writes again once the new map is identified, until "
        "then the configured fallback applies. Disarm first if this is not wanted. "
        "The name plate in Identification comes from the configuration.",
        effect=Effect.BASELINE,
    ),
    Action(
        "acknowledge",
        "Acknowledge",
        Subject.ALARM,
        "Acknowledge the alarm: it was seen. Changed also ends then; all other alarms end when "
        "the measured value is back within the limit.",
        values=1,
        by_mqtt=True,
    ),
    Action(
        "confirm",
        "Confirm",
        Subject.ALARM,
        "Confirm that the cause was dealt with, after Acknowledge.",
        values=1,
    ),
    Action("remark", "AddComment", Subject.ALARM, "Add a comment to the alarm.", values=1),
    Action(
        "arm",
        "Arm",
        Subject.INVERSE,
        "Arm writing of RequiredU to the valve; a restart disarms it.",
        effect=Effect.ARMED,
        in_fleet=False,
    ),
    Action(
        "disarm",
        "Disarm",
        Subject.INVERSE,
        "Disarm: write nothing more to the valve; the source takes its own command.",
        effect=Effect.DISARMED,
        in_fleet=False,
    ),
)

NAMED: Final = {action.name: action for action in ACTIONS}
BY_MQTT: Final = tuple(action.name for action in ACTIONS if action.by_mqtt)
"""Names of the commands that the configuration may allow to MQTT clients."""


def actions_on(subject: Subject) -> tuple[Action, ...]:
    """Return the commands on a subject, in the order of the table."""
    return tuple(action for action in ACTIONS if action.on is subject)
