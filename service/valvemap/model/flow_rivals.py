"""Operators that are not in use, and their evidence by all looks.

A look has the last rows only, in which half a percent of play leaves little. Different looks have
different rows, so their log likelihoods add up. Each operator is judged by the parameters of the
looks before: parameters that fit the noise of one look gain nothing in the next (Dawid 1984,
prequential analysis).

A rival is the combination in use and one operator more. A row of the table holds the sum of its log
likelihood over the combination in use, and its parameters. Noise and periods of signals, and U's
reaction to noise, are no rivals: one look decides on them.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.flow_memory import RIVAL_PARAMETERS, RIVAL_SUM
from valvemap.model.samples import Floats, Singles

HYSTERESES: Final = paths.PLAY, paths.STICK, paths.RELAYS  # the plainest first
OF_RIVALS: Final = slice(paths.TOP + 1)  # parameters that rivals may have more
SUM, PARAMETERS = RIVAL_SUM, slice(RIVAL_PARAMETERS, RIVAL_PARAMETERS + OF_RIVALS.stop)
COLUMNS: Final = PARAMETERS.stop
PLACES: Final = 3


def none() -> Singles:
    """Table (PLACES, COLUMNS) without a rival."""
    return np.zeros((PLACES, COLUMNS), np.float32)


class Rivals:
    """A table, written in place, beside the combination in use (PARAMETERS,).

    Examples
    --------
    >>> given, with_play = np.zeros(paths.PARAMETERS), np.zeros(paths.PARAMETERS)
    >>> with_play[paths.PLAY] = 0.5
    >>> rivals = Rivals(none(), given)
    >>> rivals.meet(12.0, with_play)
    >>> rivals.weigh([(9.0, with_play)])
    >>> round(rivals.gain(with_play, given), 1)  # 12 of an earlier look, faded, and 9
    20.4
    """

    def __init__(self, table: Singles, given: Floats) -> None:
        self._table, self._given = table, given

    def __iter__(self) -> Iterator[Floats]:
        """Parameters of each rival (PARAMETERS,)."""
        for row in self._table[self._table[:, SUM] > 0.0]:
            at = self._given.copy()
            at[OF_RIVALS] = row[PARAMETERS]
            yield at

    @property
    def best(self) -> float:
        """The largest sum."""
        return float(self._table[:, SUM].max())

    def gain(self, better: Floats, than: Floats) -> float:
        """Log likelihood ratio of the rows before; 0 where one of the two is no rival."""
        one, other = self._sum_of(better), self._sum_of(than)
        return 0.0 if one is None or other is None else one - other

    def weigh(self, gains: list[tuple[float, Floats]]) -> None:
        """Add log likelihoods of new rows over the combination in use; move to other parameters."""
        self._table[:, SUM] *= rules.RIVALS_KEPT
        for gain, at in gains:
            row = self._row(at)
            if row is not None:
                row[SUM] += min(gain, rules.MOST_OF_LOOK)
                share = min(max(gain, 0.0) / max(float(row[SUM]), 1e-30), 1.0)
                row[PARAMETERS] += share * (at[OF_RIVALS] - row[PARAMETERS])
        self._table[self._table[:, SUM] <= 0.0] = 0.0

    def meet(self, gain: float, at: Floats) -> None:
        """Add a rival that gains, in place of the one that gained least."""
        row = self._table[np.argmin(self._table[:, SUM])]
        more = np.flatnonzero(_operators(at) != _operators(self._given))
        is_rival = len(more) == 1 and at[more[0]] and more[0] < OF_RIVALS.stop
        if is_rival and self._row(at) is None and gain > row[SUM]:
            row[SUM], row[PARAMETERS] = min(gain, rules.MOST_OF_LOOK), at[OF_RIVALS]

    def forget(self) -> None:
        """Drop all: another combination is in use."""
        self._table[:] = 0.0

    def _sum_of(self, at: Floats) -> float | None:
        row = self._row(at)
        if row is not None:
            return float(row[SUM])
        return 0.0 if (_operators(at) == _operators(self._given)).all() else None

    def _row(self, at: Floats) -> Singles | None:
        """The row of these operators; None without one."""
        if (_operators(at) != _operators(self._given))[OF_RIVALS.stop :].any():
            return None
        alike = _operators(self._table[:, PARAMETERS]) == _operators(at)[OF_RIVALS]
        rows = np.flatnonzero(alike.all(axis=1) & (self._table[:, SUM] > 0.0))
        return self._table[rows[0]] if len(rows) else None


def _operators(at: Floats | Singles) -> NDArray[np.bool_]:
    """Which there are (…, n); all kinds of hysteresis are taken for the first."""
    there = at != 0.0
    first, *others = HYSTERESES
    there[..., first] |= there[..., others].any(axis=-1)
    there[..., others] = False
    return np.asarray(there)
