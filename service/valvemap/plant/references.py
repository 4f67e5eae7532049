"""What pressures are measured against, the atmosphere or vacuum, where that makes a difference.

Of two gauges of one kind it cancels in Δp. Where one states that it is absolute and the other
nothing, or where at rest one shows the atmosphere and the other 0, Δp is 1 bar off if they are
taken as alike.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.pipeline.units import Measure, absolute, inside, is_absolute
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.law import moves
from valvemap.plant.questions import Question
from valvemap.plant.reading import Floats, Given, Reading, Record
from valvemap.plant.reading_questions import question_of_references
from valvemap.plant.readings import readings
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.scales import Scale

_PRESSURES: Final = (Role.P1, Role.P2)
_ATMOSPHERE: Final = (0.95, 1.07)  # bar, of an absolute gauge without pressure
_NOTHING: Final = 0.1  # bar; a gauge against the atmosphere without pressure shows less


def question_of_reference(
    group: Group, best: Reading, record: Record, given: Given, rating: Rating
) -> Question | None:
    """Ask what a pressure is measured against if that is not clear and not all the same."""
    role = next(_unclear(best, given), None)
    if role is None:
        return None
    own = best.scales[role]
    unit = own.measure.unit or inside(QUANTITY[role])
    vacuum = Scale(replace(own.measure, unit=absolute(unit)), own.prior, "as answered")
    nodes = {one: node.node for one, node in best.nodes.items()}
    scales = {**best.scales, role: vacuum}
    other = readings(group, record, replace(given, nodes=nodes, scales=scales), rating)
    return question_of_references(group.name, role, [best, *other[:1]])


def _unclear(best: Reading, given: Given) -> Iterator[Role]:
    """Yield the pressure that may be absolute while the other one is not, or is."""
    if not set(_PRESSURES) <= set(best.nodes):
        return
    for role, other in (_PRESSURES, _PRESSURES[::-1]):
        measures = [best.scales[one].measure for one in (role, other)]
        if role in given.scales or best.nodes[role].label.gauge or _is_of_vacuum(measures[0]):
            continue
        values, others = best.values[role], best.values[other]
        if _is_of_vacuum(measures[1]):
            if _lowest(values) > _NOTHING:
                yield role
        elif _rests_at(values, *_ATMOSPHERE) and _rests_at(others, -_NOTHING, _NOTHING):
            yield role


def _is_of_vacuum(measure: Measure) -> bool:
    return measure.unit is not None and is_absolute(measure.unit)


def _lowest(values: Floats) -> float:
    good = values[np.isfinite(values)]
    return float(good.min()) if len(good) else np.inf


def _rests_at(values: Floats, low: float, high: float) -> bool:
    good = values[np.isfinite(values)]
    return len(good) > 0 and not moves(good) and bool(low <= np.median(good) <= high)
