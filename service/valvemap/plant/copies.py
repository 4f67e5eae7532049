"""Copies of a signal beside it: the same values, or the same ones rounded, as for a display."""

from dataclasses import replace
from itertools import permutations
from typing import Final

import numpy as np

from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import Group
from valvemap.plant.reading import Floats, Given, Record

_FEWEST: Final = 8  # distinct values of a copy: fewer agree with another signal's by chance
_GAIN: Final = 0.02  # of a copy against its original; a second meter differs by more
_ROUNDING: Final = 1e-6  # of a step; what arithmetic adds to half of one


def without_copies(group: Group, record: Record, given: Given) -> tuple[Group, list[Candidate]]:
    """Return a valve's variables without the copies of others, and the copies.

    Of two variables with the same meaning and equal values, the one with the less likely name is
    the copy. A variable that an answer names is kept.
    """
    copies: list[Candidate] = []
    named = set(given.nodes.values())
    for one, other in permutations(group.all, 2):
        if other.node in named or {one, other} & set(copies):
            continue
        if _is_copy(one, other, record):
            copies.append(other)
    kept = [[one for one in part if one not in copies] for part in (group.own, group.shared)]
    return replace(group, own=tuple(kept[0]), shared=tuple(kept[1])), copies


def _is_copy(original: Candidate, other: Candidate, record: Record) -> bool:
    label, its = original.label, other.label
    if not label.is_relevant or (label.role, label.units) != (its.role, its.units):
        return False
    values, rounded = record.of(original), record.of(other)
    if len(values) != len(rounded):
        return False
    both = np.isfinite(values) & np.isfinite(rounded)
    values, rounded = values[both], rounded[both]
    if np.array_equal(values, rounded):
        is_less_likely = its.evidence[its.role] < label.evidence[label.role]
        return len(np.unique(rounded)) >= _FEWEST and is_less_likely
    step = _step(rounded)
    off, about = rounded - values, values - values.mean()
    is_finer = 0.0 < _step(values) < step
    is_near = bool(np.all(np.abs(off) <= (0.5 + _ROUNDING) * step))
    return is_finer and is_near and bool(abs(off @ about) <= _GAIN * (about @ about))


def _step(values: Floats) -> float:
    """Return the least difference of distinct values; 0 if they are too few."""
    distinct = np.unique(values)
    return float(np.diff(distinct).min()) if len(distinct) >= _FEWEST else 0.0
