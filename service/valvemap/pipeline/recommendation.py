"""The recommended estimator of a valve in words: why, how sure, what would improve it. Pure."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from valvemap.pipeline.place_errors import FEWEST_PLACES
from valvemap.pipeline.place_ranking import Ranking

CLEAR: Final = 0.95  # probability from which the recommended estimator is called better


class Recommendation(NamedTuple):
    """The recommended estimator's name, empty if there is none, and the reason."""

    name: str
    reason: str


NOT_YET: Final = Recommendation("", "No estimator has been compared yet.")


def recommendation(ranking: Ranking, names: Sequence[str], inverse: str) -> Recommendation:
    """Return the recommendation of one valve.

    Parameters
    ----------
    ranking
        The errors of its E estimators at places visited again.
    names
        Of the estimators (E,).
    inverse
        The estimator whose map is inverted now.

    Examples
    --------
    >>> ranking = Ranking(1, 0.99, np.array([1.7, 0.42, np.inf]), 32)
    >>> print(recommendation(ranking, ("RLS", "Auto", "RBF"), "Auto").reason)
    Auto has the least error at 32 places visited again: 0.42 l/min, next RLS 1.7 l/min (99 % sure).
    """
    advice = _advice(ranking)
    if ranking.chosen < 0:
        why = (
            f"None is recommended: fewer than {FEWEST_PLACES} places were visited again with a map "
            f"that predicts better than the mean flow. The inverse is that of {inverse}.{advice}"
        )
        return Recommendation("", why)
    name = names[ranking.chosen]
    error, others = ranking.errors[ranking.chosen], ranking.errors.copy()
    others[ranking.chosen] = np.inf
    where = f"at {ranking.places} places visited again: {error:.2g} l/min"
    if not np.isfinite(others).any():
        why = f"{name} alone predicts better than the mean flow {where}."
        return Recommendation(name, why + advice)
    next_best = int(np.argmin(others))
    other = f"{names[next_best]} {others[next_best]:.2g} l/min"
    sure = int(100.0 * min(ranking.sure, 0.99))
    if ranking.sure >= CLEAR:
        why = f"{name} has the least error {where}, next {other} ({sure} % sure)."
    else:
        why = f"{name} has as small an error as any {where}; {other} is not clearly different."
    if inverse != name:
        why += f" The inverse is configured to be that of {inverse}."
    return Recommendation(name, why + advice)


def _advice(ranking: Ranking) -> str:
    """Name what would improve map and ranking."""
    if not np.isfinite(ranking.U):
        return ""
    where = f"U = {ranking.U:.0f} %, dp = {ranking.dp:.0f} bar"
    return f" More visits around {where} would improve it most."
