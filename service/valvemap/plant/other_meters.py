"""Two meters of one flow that disagree: the orifice law fits both, whatever their factor is."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from valvemap.plant.reading import Floats, Reading
from valvemap.plant.roles import Role

_AS_LIKELY: Final = 1.5  # nats between the labels of two meters of which neither is named better
_ALIKE: Final = 0.02  # of its variance: what another meter of the same flow leaves of a signal
_EQUAL: Final = 0.02  # of a flow, by which two right meters may differ


def other_meter(best: Reading, found: Sequence[Reading]) -> Reading | None:
    """Return a reading with another meter, labelled as well, that shows the same but for a factor.

    Which of the two is right, no value says.
    """
    if best.mistake or not best.fit.moves:
        return None
    own = best.nodes[Role.Q]
    for one in found:
        node = one.nodes.get(Role.Q, own)
        is_by_labels = not (one.missing or one.mistake or one.beside)
        if not is_by_labels or node.node == own.node or not _is_else_the_same(best, one):
            continue
        evidence = node.label.evidence[Role.Q] - own.label.evidence[Role.Q]
        is_as_likely = abs(evidence) < _AS_LIKELY
        if is_as_likely and _differ_in_scale(best.values[Role.Q], one.values[Role.Q]):
            return one
    return None


def _is_else_the_same(best: Reading, one: Reading) -> bool:
    return all(
        role in one.nodes
        and one.nodes[role].node == node.node
        and one.scales[role].text == best.scales[role].text
        for role, node in best.nodes.items()
        if role is not Role.Q
    )


def _differ_in_scale(one: Floats, other: Floats) -> bool:
    """Whether N values of two signals are proportional, and not equal."""
    good = np.isfinite(one) & np.isfinite(other)
    one, other = one[good], other[good]
    scale = float(one @ other) / max(float(one @ one), 1e-12)
    rest = other - scale * one
    spread = max(float(np.std(other)), 1e-12)
    is_alike = float(np.std(rest)) < _ALIKE**0.5 * spread
    is_offset = abs(float(np.mean(rest))) > _ALIKE**0.5 * spread
    return is_alike and not is_offset and abs(scale - 1.0) > _EQUAL
