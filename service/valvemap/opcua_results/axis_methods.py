"""The methods of an axis: the inverse at given pressures, and a new reference."""

from functools import partial
from typing import Final

from asyncua import ua

from guarded_opcua import Argument, HardenedServer, Role, Unit, add_method
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.information_model import DIAGNOSTICS, INVERSE
from valvemap.pipeline.axis_ports import AxisOperator, RequiredU
from valvemap.pipeline.operator_ports import Answer
from valvemap.vocabulary.commands import NAMED
from valvemap.vocabulary.statuses import InverseStatus

SPEEDS: Final = (-5_000.0, 5_000.0)  # mm/s; faster than any cylinder
_PRESSURES: Final = (0.0, 1_000.0)
_TEMPERATURES: Final = (-50.0, 200.0)


async def add_invert(
    server: HardenedServer, parent: ua.NodeId, axis: str, operator: AxisOperator
) -> None:
    """Add the method Invert below the folder of the inverse."""
    pressures = tuple(
        Argument(
            name,
            "Pressure; NaN takes the one measured last",
            unit=Unit.BAR,
            value_range=_PRESSURES,
            or_nan=True,
        )
        for name in ("pA", "pB", "pS", "pT")
    )
    speed = Argument("v", "Speed", unit=Unit.MILLIMETRE_PER_SECOND, value_range=SPEEDS)
    temperature = Argument(
        "T",
        "Oil temperature, which moves the leakage; NaN takes the newest",
        unit=Unit.DEGREE_CELSIUS,
        value_range=_TEMPERATURES,
        or_nan=True,
    )
    numbered = ", ".join(f"{member.value} {member.name}" for member in InverseStatus)
    await add_method(
        server,
        parent,
        f"{axis}.{INVERSE}.Invert",
        partial(_invert, operator, axis),
        inputs=(speed, *pressures, temperature),
        outputs=(
            Argument("U", "Control voltage; NaN if none can be trusted", unit=Unit.PERCENT),
            Argument("Lower", "Lower end of its 95 % interval", unit=Unit.PERCENT),
            Argument("Upper", "Upper end of its 95 % interval", unit=Unit.PERCENT),
            Argument("Status", "How far the answer can be trusted", ua.VariantType.Int32),
        ),
        required=Role.OBSERVER,
        description="Control voltage U (%) for a speed v (mm/s, above 0 extends) at these "
        "pressures (bar), in the middle of the loop of Play: add half of it while U rises, "
        "subtract half while U falls. Lower and Upper are the ends of its 95 % interval. "
        f"Status: {numbered}.",
    )


def _invert(
    operator: AxisOperator,
    axis: str,
    v: float,
    pA: float,
    pB: float,
    pS: float,
    pT: float,
    T: float,
) -> Answer[tuple[float, float, float, int]]:
    def numbers(found: RequiredU) -> tuple[float, float, float, int]:
        return found.U, found.lower, found.upper, int(found.status)

    return answered(partial(operator.invert_speed, axis, v, pA, pB, pS, pT, T), numbers)


async def add_set_reference(
    server: HardenedServer, parent: ua.NodeId, axis: str, operator: AxisOperator
) -> None:
    """Add the method SetReference below the folder of the findings."""
    await add_method(
        server,
        parent,
        f"{axis}.{DIAGNOSTICS}.SetReference",
        partial(_set_reference, operator, axis),
        inputs=(),
        outputs=(),
        required=Role.OPERATOR,
        description="After a repair: learns the axis again. Findings come again after 210 s of "
        "movement, relative to what it is from now on.",
    )


async def add_arming(
    server: HardenedServer, parent: ua.NodeId, axis: str, operator: AxisOperator
) -> None:
    """Add the methods Arm and Disarm below the folder of the inverse."""
    for action, armed in ((NAMED["arm"], True), (NAMED["disarm"], False)):
        await add_method(
            server,
            parent,
            f"{axis}.{INVERSE}.{action.method}",
            partial(_arm, operator, axis, armed),
            inputs=(),
            outputs=(),
            required=Role.OPERATOR,
            description=action.sentence,
        )


def _arm(operator: AxisOperator, axis: str, armed: bool) -> Answer[None]:  # noqa: FBT001 - a method's own
    return answered(partial(operator.arm_axis, axis, armed=armed), lambda _: None)


def _set_reference(operator: AxisOperator, axis: str) -> Answer[None]:
    return answered(partial(operator.set_reference, axis), lambda _: None)
