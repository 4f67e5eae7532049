"""Two meters of one flow that disagree: the orifice law fits both, whatever their factor is."""

from typing import Final

import numpy as np

from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import Group
from valvemap.plant.law import LEAST_ROWS, noise_variance
from valvemap.plant.reading import Floats, Reading, Record
from valvemap.plant.roles import Role
from valvemap.plant.scales import scales

_AS_LIKELY: Final = 1.5  # nats between the labels of two meters of which neither is named better
_ALIKE: Final = 0.02  # of its variance: what another meter of the same flow leaves of a signal
_EQUAL: Final = 0.02  # of a flow, by which two right meters may differ


def other_meter(best: Reading, group: Group, record: Record) -> Candidate | None:
    """Return another meter, labelled as well, that shows the same flow but for a factor.

    Which of the two is right, no value says. A meter of line B is one of the valve's flow, too,
    where no pressure is that of a line.
    """
    if best.mistake or not best.fit.moves:
        return None
    own, Q = best.nodes[Role.Q], best.values[Role.Q]
    has_lines = any(one.label.role in {Role.PA, Role.PB} for one in group.all)
    roles = (Role.Q,) if has_lines else (Role.Q, Role.QB)
    named = max(own.label.evidence[role] for role in roles)
    taken = {node.node for node in best.nodes.values()}
    for one in group.all:
        is_as_likely = max(one.label.evidence[role] for role in roles) > named - _AS_LIKELY
        if one.node in taken or not is_as_likely or len(record.of(one)) != len(Q):
            continue
        scale = scales(one, Role.Q, record.of(one))[0]
        if _differ_in_scale(Q, scale(record.of(one), Role.Q)):
            return one
    return None


def _differ_in_scale(one: Floats, other: Floats) -> bool:
    """Whether N values of two signals are proportional but for their noise, and not equal."""
    good = np.isfinite(one) & np.isfinite(other)
    one, other = one[good], other[good]
    if len(one) < LEAST_ROWS:
        return False
    own = float(one @ one) - len(one) * noise_variance(one)  # noise makes a slope too flat
    scale = float(one @ other) / max(own, 1e-12)
    rest = other - scale * one
    spread = max(float(np.std(other)), 1e-12)
    left = max(float(np.var(rest)) - noise_variance(rest), 0.0)
    is_alike = left < _ALIKE * spread**2
    is_offset = abs(float(np.mean(rest))) > _ALIKE**0.5 * spread
    return is_alike and not is_offset and abs(scale - 1.0) > _EQUAL
