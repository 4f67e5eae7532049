"""Which operators lie between map and samples: a search for the parameters of `kernels.flow_path`.

The log likelihood of the last n samples, up to a constant, is

    L = -n·(1 - ρ) / (1 + ρ) / 2 · ln(mean square of what a coarse map leaves)

with ρ the correlation of successive residuals, that of the better model in a comparison. An
operator is taken where it gains `rules.CLEAR`, the one that gains most first; one that is there is
kept until the rows are likelier without it by `rules.STILL_CLEAR`.
"""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from valvemap.model.kernels import flow_evidence
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.flow_basis import Axis, axis
from valvemap.model.samples import Floats

TRIED: Final = {
    paths.DEAD_U: (0.03, 0.07, 0.15, 0.3, 0.6),
    paths.LAG_U: (0.02, 0.06, 0.2, 0.6),
    paths.PLAY: (0.3, 0.8, 1.5, 2.5, 4.0),
    paths.STICK: (0.4, 1.0, 2.0, 4.0),
    paths.RELAYS: (0.4, 1.0, 2.0, 4.0),
    paths.CHOKE: (0.9, 0.8, 0.7, 0.6, 0.5),
    paths.KNEE: (5.0, 8.0, 12.0, 18.0, 27.0, 40.0),
    paths.DEAD_Q: (0.03, 0.07, 0.15, 0.3, 0.6),
    paths.AVERAGE: (0.06, 0.15, 0.4, 0.7, 1.0, 1.5),
    paths.LAG_Q: (0.02, 0.06, 0.2, 0.6),
}
LIMITS: Final = {paths.CHOKE: (0.2, 0.98), paths.DEAD_U: (0.0, 1.0), paths.DEAD_Q: (0.0, 1.0)}
STEPS: Final = (1.25, 1.1, 1.04, 1.015, 1.005, 1.0015, 1.0005)
ONE_OF: Final = (  # of these operators there is one at most
    {paths.PLAY, paths.STICK, paths.RELAYS},
    {paths.CHOKE, paths.KNEE},
)
LAGS: Final = (paths.DEAD_U, paths.LAG_U, paths.DEAD_Q, paths.AVERAGE, paths.LAG_Q)
RIVALS: Final = (  # operators of much the same effect
    (paths.PLAY, paths.STICK, paths.RELAYS),
    (paths.CHOKE, paths.KNEE),
    LAGS,
)


class Evidence:
    """Log likelihoods of the rows, each computed once, for a valve of these axes."""

    def __init__(self, axis_U: Axis, axis_s: Axis, rows: Floats) -> None:
        self.rows, self.Q, self._top = rows, rows[:, paths.LEFT_Q], float(axis_s.breaks[-1])
        self._axis = coarse(axis_U.breaks[0], axis_U.breaks[-1])
        self._known: dict[tuple[float, ...], tuple[float, float, float]] = {}

    def of(self, given: Floats) -> tuple[float, float, float]:
        """Mean square, correlation, count."""
        key = tuple(given.tolist())
        if key not in self._known:
            out = self._fit(given)[1]
            self._known[key] = float(out[0]), float(out[1]), float(out[2])
        return self._known[key]

    @property
    def spent(self) -> int:
        """How many fits there were."""
        return len(self._known)

    def _fit(self, given: Floats) -> tuple[Floats, Floats]:
        b, out = np.zeros(flow_evidence.terms_of(self._axis)), np.empty(3)
        flow_evidence.leftover(self._axis, self._top, self.rows, given, b, out)
        return b, out

    def fill(self, given: Floats, axis_U: Axis, axis_s: Axis, theta: Floats) -> None:
        """Fill the map's coefficients with those of the coarse map."""
        b, _ = self._fit(given)
        flow_evidence.refine(self._axis, self._top, b, axis_U, axis_s, theta)

    def gain(self, better: Floats, than: Floats, most: float = rules.MOST_COLOUR) -> float:
        """Log likelihood ratio, with a correlation of ``most`` at most."""
        (square, rho, count), (other, other_rho, _) = self.of(better), self.of(than)
        if not (square > 0.0 and other > 0.0):
            return 0.0
        rho = min(max(rho if square <= other else other_rho, 0.0), most)
        return 0.5 * count * (1.0 - rho) / (1.0 + rho) * math.log(other / square)


def coarse(low: float, high: float) -> Axis:
    """Axis of the coarse map."""
    size = max(abs(low), abs(high))
    shares = size * np.array(rules.SHARES_COARSE)
    breaks = np.concatenate([-shares[:0:-1], shares]) if low < 0.0 else shares
    return axis(breaks)


def search(evidence: Evidence, given: Floats) -> tuple[Floats, Floats]:
    """Parameters that the rows need, from ``given`` on, and what each of them gains.

    Operators are added while the rows fit better as if residuals were white, since one of several
    that are missing whitens nothing alone. Those that gain too little in the end are dropped.
    """
    at = given.copy()
    if np.count_nonzero(given):
        is_explained = evidence.of(at)[0] < rules.EXPLAINED * noise_of(evidence.Q) ** 2
        at = (_settled if is_explained else _likeliest)(evidence, at)
    for _ in range(rules.MOST_OPERATORS):
        found = max(
            ((evidence.gain(tried, at, most=0.0), tried) for tried in _others(evidence, at)),
            key=lambda one: one[0],
        )
        if found[0] < rules.CLEAR:
            break
        at = _likeliest(evidence, found[1])
    at = _needed(evidence, at, given)
    gains = np.zeros(paths.PARAMETERS)
    for k in np.flatnonzero(at):
        gains[k] = evidence.gain(at, _with(at, int(k), 0.0))
    return at, gains


def end_of_meter(evidence: Evidence, given: Floats) -> float:
    """Flow at which the meter ends, 0 where the rows do not need one."""
    tried = [at for at in _others(evidence, given) if at[paths.TOP] != given[paths.TOP]]
    if not tried:
        return 0.0
    at = _refined(evidence, min(tried, key=lambda at: evidence.of(at)[0]), paths.TOP)
    return float(at[paths.TOP]) if evidence.gain(at, given) >= rules.CLEAR else 0.0


def _likeliest(evidence: Evidence, at: Floats) -> Floats:
    """Refine all operators, and try rivals in the place of each."""
    best = _settled(evidence, at)
    improved = True
    while improved and evidence.spent < rules.MOST_TRIED:
        improved = False
        for k, rival in _rivals(best):
            starts = (_with(_with(best, k, 0.0), rival, value) for value in TRIED[rival])
            start = min(starts, key=lambda tried: evidence.of(tried)[0])
            other = _settled(evidence, start)
            if evidence.gain(other, best) > rules.LIKELIER:
                best, improved = other, True
                break
    return best


def _rivals(at: Floats) -> list[tuple[int, int]]:
    """Operators that are there, with those that may stand in their place."""
    return [
        (k, rival) for group in RIVALS for k in group if at[k] for rival in group if not at[rival]
    ]


def _settled(evidence: Evidence, at: Floats) -> Floats:
    """Refine all operators in turn until none moves."""
    for _ in range(rules.REFINEMENTS):
        before = at
        for k in np.flatnonzero(at):
            at = _refined(evidence, at, int(k))
        if np.array_equal(at, before):
            break
    return at


def _needed(evidence: Evidence, at: Floats, given: Floats) -> Floats:
    """Drop what gains too little, the least first; what was there is kept unless refuted."""
    while True:
        short = [
            (evidence.gain(at, _with(at, int(k), 0.0)) - bar, int(k))
            for k in np.flatnonzero(at)
            for bar in (-rules.STILL_CLEAR if given[k] else rules.CLEAR,)
        ]
        if not short or min(short)[0] >= 0.0:
            return at
        at = _with(at, min(short)[1], 0.0)


def _with(at: Floats, k: int, value: float) -> Floats:
    other = at.copy()
    other[k] = value
    return other


def _others(evidence: Evidence, at: Floats) -> Iterator[Floats]:
    """Parameters with one more operator, or with another in its place."""
    for k, values in TRIED.items():
        for value in values:
            if not at[k]:
                tried = _with(at, k, value)
                for group in ONE_OF:
                    if k in group:
                        tried[[other for other in group if other != k]] = 0.0
                yield tried
                for other in LAGS if k in LAGS else ():  # a share of what another one bears
                    if at[other] > value:
                        yield _with(tried, other, at[other] - value)
    if not at[paths.TOP]:
        for share in rules.SHARES_TOP:
            yield _with(at, paths.TOP, float(np.quantile(evidence.Q, share)))


def least_shown(Q: Floats, noise: float) -> tuple[float, float]:
    """Least flow that readings in the order of time show, and what they say for its being a bound.

    A flow that rises steadily from none passes all sizes. A meter with a least flow jumps over
    them, while its next reading is near the one after the jump.
    """
    sizes = np.abs(Q)
    none = 0.0 if np.count_nonzero(sizes == 0.0) >= rules.SEEN_BELOW else 4.0 * noise
    above = sizes[sizes > none]
    least = float(above.min()) if len(above) else math.inf
    before, at, behind = sizes[:-2], sizes[1:-1], sizes[2:]
    up = (before <= none) & (at > none) & (np.abs(behind - at) < 0.5 * least)
    down = (behind <= none) & (at > none) & (np.abs(before - at) < 0.5 * least)
    if not rules.LEAST_NOISES * noise < least < math.inf or least < 2.0 * none:
        return least, 0.0
    each = min(0.25 * (least / max(noise, 1e-9)) ** 2, rules.MOST_OF_JUMP)
    return least, each * float(np.count_nonzero(up | down))


def noise_of(Q: Floats) -> float:
    """Standard deviation of white noise in readings, from their second differences."""
    bends = np.abs(Q[2:] - 2.0 * Q[1:-1] + Q[:-2])
    return float(rules.MEDIAN_TO_STD * np.median(bends) / math.sqrt(6.0)) if len(bends) else 0.0


def _refined(evidence: Evidence, at: Floats, k: int) -> Floats:
    """The likeliest value of parameter k nearby."""
    low, high = LIMITS.get(k, (0.0, math.inf))
    if k == paths.TOP:
        high = float(np.max(evidence.Q))
    for step in STEPS:
        for factor in (step, 1.0 / step):
            while True:
                tried = _with(at, k, min(max(at[k] * factor, low), high))
                if tried[k] == at[k] or not evidence.gain(tried, at) > 0.0:
                    break
                at = tried
    return at
