"""Forgetting rules as the numbers that the kernels of least squares take."""

from functools import lru_cache
from typing import assert_never

import numpy as np

from valvemap.model.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Forgetting,
    Resetting,
    SlidingWindow,
    Subspace,
    Variable,
)
from valvemap.model.kernels import rules
from valvemap.model.kernels.change_detection import SUSPICIOUS, value_of
from valvemap.model.kernels.place_visits import LONGEST
from valvemap.model.kernels.rules import EVERY_NTH, Rule


@lru_cache(maxsize=64)
def rule_of(forgetting: Forgetting, n: int) -> Rule:
    """Return the rule's numbers for n parameters."""
    match forgetting:
        case Exponential(lam):
            rule = Rule(rules.EXPONENTIAL, lam)
        case Variable(lam, least):
            rule = Rule(rules.VARIABLE, lam, least)
        case Resetting(lam, information):
            rule = Rule(rules.RESETTING, lam, information)
        case Directional(lam):
            rule = Rule(rules.DIRECTIONAL, lam)
        case Subspace(lam):
            rule = Rule(rules.SUBSPACE, lam)
        case SlidingWindow():
            rule = Rule(rules.WINDOW, forgetting.lam)
        case Adaptive(lam, least, threshold):
            slowest = 1.0 - lam if lam < 1.0 else 1.0 / LONGEST
            most = np.log(max(1.0, (1.0 - least) / slowest))
            limits = value_of(SUSPICIOUS, n), value_of(threshold, n)
            rule = Rule(rules.SUBSPACE, lam, least, *limits, EVERY_NTH, float(most))
        case _:
            assert_never(forgetting)
    return rule


def keeps_all(forgetting: Forgetting) -> bool:
    """Whether a rule keeps all information unless places drift."""
    return isinstance(forgetting, Adaptive) and forgetting.lam == 1.0
