"""Nodes that hold the factor of a number beside them: ``Scale``, ``Divisor``, ``Decimals``."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.units import Measure
from valvemap.plant.candidates import Candidate
from valvemap.plant.concepts import CARRIERS
from valvemap.plant.names import tokens
from valvemap.plant.priors import ODD
from valvemap.plant.scales import Scale

Floats = NDArray[np.float64]

_FACTORS: Final = frozenset(
    {
        "scale", "factor", "gain", "multiplier", "scaling", "skalierung", "faktor", "facteur",
        "echelle", "escala", "fattore", "scala", "mnoznik", "系数", "倍率", "係数",
    }
)  # fmt: skip
_DIVISORS: Final = frozenset({"divisor", "teiler", "diviseur", "divisore"})
_DECIMALS: Final = frozenset({"decimals", "nachkommastellen", "decimales", "decimali", "小数位"})
_FACTOR: Final[tuple[tuple[frozenset[str], Callable[[float], float]], ...]] = (
    (_FACTORS, lambda number: number),
    (_DIVISORS, lambda number: 1.0 / number if number else 0.0),
    (_DECIMALS, lambda number: 10.0**-number),
)
"""Words of a node's name, and the factor that its number means."""


def with_companions(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Return the variables, an integer ``Value`` with the node of its factor in the same folder.

    >>> number = Candidate("n1", ("PT1", "Value"), largest=32_767.0)
    >>> with_companions([number, Candidate("n2", ("PT1", "Scale"))])[0].companion.node
    'n2'
    """
    every = list(candidates)
    beside: dict[tuple[str, ...], list[Candidate]] = {}
    for one in every:
        if _meaning(one) is not None:
            beside.setdefault(one.path[:-1], []).append(one)
    return [replace(one, companion=_companion_of(one, beside)) for one in every]


def multiplied(
    node: Candidate, factor: float, readings: Iterable[Scale], plain: Iterable[Scale]
) -> list[Scale]:
    """Return the readings of a number by its factor, and those without it."""
    found = [_times(one, factor, node) for one in readings]
    rest = [replace(one, prior=one.prior + log(ODD)) for one in plain]
    return [*found, *rest]


def factor_of(node: Candidate, values: Floats) -> float | None:
    """Return the factor that a companion's values (N,) mean; None if they move, or mean none."""
    meaning, good = _meaning(node), values[np.isfinite(values)]
    if meaning is None or not len(good) or float(np.ptp(good)) > 0.0:
        return None
    factor = meaning(float(good[0]))
    return factor if np.isfinite(factor) and factor > 0.0 and factor != 1.0 else None


def _meaning(one: Candidate) -> Callable[[float], float] | None:
    words = set(tokens(one.path[-1]))
    return next((own for known, own in _FACTOR if words and words <= known), None)


def _companion_of(
    one: Candidate, beside: Mapping[tuple[str, ...], list[Candidate]]
) -> Candidate | None:
    if one.largest is None or not set(tokens(one.path[-1])) <= CARRIERS:
        return None
    there = beside.get(one.path[:-1], [])
    return there[0] if len(there) == 1 else None


def _times(scale: Scale, factor: float, node: Candidate) -> Scale:
    measure = scale.measure
    raw, scaled = measure.raw or (0.0, 1.0), measure.scaled or (0.0, 1.0)
    own = Measure(None, measure.unit, (raw[0] / factor, raw[1] / factor), scaled)
    if measure.raw is None:
        own = Measure(None, measure.unit, (0.0, 1.0), (0.0, factor))
    reason = f"{scale.reason}, times its {node.path[-1]}"
    return replace(scale, measure=own, prior=scale.prior + log(1.0 - ODD), reason=reason)
