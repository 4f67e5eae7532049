"""The recommended estimator of a valve: the least error at places visited again. Pure."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Flags, Floats, Times
from valvemap.pipeline.kernels import place_layout as layout
from valvemap.pipeline.kernels.place_layout import Record
from valvemap.pipeline.kernels.places import HOLDS, TRIED
from valvemap.pipeline.place_errors import FEWEST_PLACES, clipped

SURE: Final = 0.9  # probability of being better at which another estimator is recommended


@dataclass(frozen=True)
class Ranking:
    """The recommended estimator of one valve.

    Attributes
    ----------
    chosen : int
        Its number; -1: none.
    sure : float
        Probability that it is better than the next best, 0 to 1.
    errors : (E,)
        Errors by which the estimators are ranked, l/min; infinite for those that are no candidates.
    places : int
        Number of places at which they are compared.
    U, dp : float
        The place at which fewest samples were judged, % and bar; NaN if there is none.
    """

    chosen: int
    sure: float
    errors: Floats
    places: int
    U: float = np.nan
    dp: float = np.nan


def rank(record: Record, m: int, eligible: Flags) -> None:
    """Choose the estimator with the least error at places visited again."""
    lanes, before = record.lanes[m], chosen_of(record, np.array([m]))[0]
    lanes[:, layout.SCORE], lanes[:, layout.CHOSEN] = np.inf, 0.0
    missed = (lanes[:, layout.COVERED_N] >= TRIED) & (lanes[:, layout.COVERED] < HOLDS)
    able = (lanes[:, layout.SKILLED] > 0.0) & (lanes[:, layout.PAST_SQUARE] > 0.0)
    able &= eligible & ~missed & (lanes[:, layout.LOST] == 0.0)
    candidates = able.nonzero()[0]
    chosen = _compared(record, m, candidates)
    if chosen.sum() < FEWEST_PLACES:
        return
    squares = record.places[m, candidates][:, chosen, layout.SQUARE].astype(np.float64)
    again = clipped(squares**0.5)
    past = lanes[candidates, layout.PAST_SQUARE]
    mean = again.mean(axis=1)
    forgotten = np.maximum(past - past.min() - mean, 0.0)
    score = np.sqrt(mean + forgotten)
    lanes[candidates, layout.SCORE] = score
    errors = again + forgotten[:, None]
    best, kept = int(np.argmin(score)), (candidates == before).nonzero()[0]
    if len(kept) and _sure(errors[[best, *kept]], 0) < SURE:
        best = int(kept[0])
    lanes[candidates[best], layout.CHOSEN] = 1.0 + _sure(errors, best)


def ranking_of(record: Record, m: int) -> Ranking:
    """Return the recommended estimator of one valve, as of the last `look_back`."""
    errors = record.lanes[m, :, layout.SCORE].copy()
    compared = _compared(record, m, (np.isfinite(errors)).nonzero()[0])
    chosen = int(chosen_of(record, np.array([m]))[0])
    sure = record.lanes[m, chosen, layout.CHOSEN] - 1.0 if chosen >= 0 else 0.0
    known = (record.seen[m] > 0).nonzero()[0]
    U = dp = np.nan
    if len(known):
        judged = record.places[m, max(chosen, 0), known, layout.JUDGED]
        U, dp = record.points[m, known[np.argmin(judged)], : layout.AT_T].tolist()
    return Ranking(chosen, float(sure), errors, int(compared.sum()), U, dp)


def chosen_of(record: Record, members: Times) -> Times:
    """Return the number of the recommended estimator of each given valve (K,); -1: none."""
    marks = record.lanes[members, :, layout.CHOSEN]
    return np.where(marks.any(axis=1), marks.argmax(axis=1), -1)


def _compared(record: Record, m: int, candidates: NDArray[np.intp]) -> Flags:
    """Mask (places,) of the places at which all candidates were judged."""
    if not len(candidates):
        return np.zeros(layout.PLACES, np.bool_)
    judged = record.places[m, candidates, :, layout.JUDGED] > 0.0
    return np.asarray(judged.all(axis=0))


def _sure(squares: Floats, best: int) -> float:
    """Probability that the next best estimator's error is larger; 1 if there is no other."""
    others = np.delete(squares, best, axis=0)
    if not len(others):
        return 1.0
    steps = others[np.argmin(others.mean(axis=1))] - squares[best]
    error = float(np.std(steps)) / np.sqrt(len(steps))
    if error == 0.0:
        return 0.5
    z = float(np.clip(steps.mean() / error, -8.0, 8.0))
    return 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))
