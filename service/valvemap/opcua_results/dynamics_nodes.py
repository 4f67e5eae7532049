"""The nodes of a valve's dynamics: each quantity with its standard deviation and its status."""

import math
from collections.abc import Iterator
from typing import Final

from asyncua import ua

from guarded_opcua import Unit
from valvemap.opcua_results.information_model import DYNAMICS, VariableNode, sentences_of
from valvemap.opcua_results.result_values import Shown
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES, DynamicsStatus
from valvemap.vocabulary.statuses import Status

_UNITS: Final = {unit.value[1]: unit for unit in Unit}
_STATUSES: Final = (Status.OK, Status.UNEXCITED)  # of a quantity


def dynamics_variables(valve: str) -> Iterator[VariableNode]:
    """Yield the variables of a valve's dynamics."""
    prefix = f"{valve}.{DYNAMICS}"
    yield VariableNode(
        f"{prefix}.Status",
        f"How the dynamics of the valve stand. {sentences_of(DynamicsStatus)}",
        ua.VariantType.Int32,
        statuses=DynamicsStatus,
    )
    yield VariableNode(
        f"{prefix}.Reason", "Status in words, with the figures behind it.", ua.VariantType.String
    )
    statuses = " or ".join(f"{status.value} {status.name}" for status in _STATUSES)
    for quantity in DYNAMIC_QUANTITIES:
        unit, name = _UNITS.get(quantity.unit), f"{prefix}.{quantity.name}"
        sentence = quantity.sentence
        if unit is None:
            sentence = f"{sentence.removesuffix('.')}, in {quantity.unit}."
        yield VariableNode(name, sentence, unit=unit, range=quantity.range)
        yield VariableNode(
            f"{name}Std",
            f"Standard deviation of {quantity.name}.",
            unit=unit,
            range=(0.0, quantity.range[1]),
        )
        yield VariableNode(
            f"{name}Status",
            f"Whether the samples determine {quantity.name}: {statuses}.",
            ua.VariantType.Int32,
            statuses=Status,
        )


def dynamics_values(results: DynamicsResults, now: int) -> Iterator[Shown]:
    """Yield the values of these variables; NaN where there is none."""
    good, t = int(ua.StatusCodes.Good), results.t or now
    yield Shown(f"{DYNAMICS}.Status", int(results.status), good, t)
    yield Shown(f"{DYNAMICS}.Reason", results.sentence, good, t)
    for quantity, found in zip(DYNAMIC_QUANTITIES, results.quantities, strict=True):
        name = f"{DYNAMICS}.{quantity.name}"
        code = good if math.isfinite(found.value) else int(ua.StatusCodes.BadNoData)
        yield Shown(name, found.value, code, t)
        yield Shown(f"{name}Std", found.std, code, t)
        yield Shown(f"{name}Status", int(found.status), good, t)
