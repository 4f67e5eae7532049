"""Which operators lie between map and samples: a search for the parameters of `kernels.flow_path`.

The log likelihood of the last n samples, up to a constant, is

    L = -n/2 · ln(mean square of the innovations of what a coarse map leaves)

whose noise has a white and a slow part (`kernels.flow_evidence`). All operators have the same odds
before anything is known: one is taken where it gains `rules.CLEAR`. One that is there is kept until
the rows are likelier without it by as much, or tell another value of it and are likelier without.

Several combinations are followed at once. Each grows by the operators that explain most of the
residual together with a change of those that are there; then all parameters are refined jointly.
"""

import math
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from valvemap.model.flow_evidence import (
    Evidence,
    jointly,
    limited,
    slopes,
    smooth,
    solved,
    with_value,
)
from valvemap.model.flow_rivals import HYSTERESES, Rivals
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
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
    paths.NEWS: (1.0,),
}
AGE: Final = {  # mean age of what a lag shows, in units of its parameter
    paths.DEAD_U: 1.0,
    paths.LAG_U: 1.0,
    paths.DEAD_Q: 1.0,
    paths.AVERAGE: 0.5,
    paths.LAG_Q: 1.0,
}
ALIKE: Final = (  # of much the same effect; of the first two groups there is one at most
    HYSTERESES,
    (paths.CHOKE, paths.KNEE),
    tuple(AGE),
)


def search(evidence: Evidence, given: Floats, rivals: Rivals) -> tuple[Floats, Floats]:
    """Return the parameters that the rows need, from ``given`` on, and the gain of each.

    Operators are added while the rows fit better as if residuals were white, since one of several
    that are missing whitens nothing alone. Those that gain too little in the end are dropped.
    Operators that are known give way only to others that are clearly likelier: rows in which
    little moves tell nothing of them. The evidence of earlier looks for ``rivals`` counts as well;
    that of this look is added to it.
    """
    at = known = given.copy()
    beam = [at]
    if np.count_nonzero(given):
        at = known = jointly(evidence, at)
        beam = [at] if evidence.explains(at) else [at, np.zeros_like(at)]
    met: list[Floats] = []
    for _ in range(rules.MOST_OPERATORS):
        beam = _grown(evidence, beam)
        met += beam
        if not beam or evidence.gain_if_white(beam[0], at) < rules.STILL_CLEAR:
            break
        at = beam[0]
    if np.count_nonzero(at):
        at = _swapped(evidence, at)
    of_rivals = [(rival, jointly(evidence, rival)) for rival in rivals]
    summed = Summed(evidence, rivals)
    known = _needed(summed, known, given)
    likely = [one for _, one in of_rivals if summed.gain(one, known) >= rules.CLEAR]
    likely = [one for one in likely if not _is_brief(evidence, one, given)]
    tried = [_plainest(evidence, _needed(summed, one, given)) for one in (at, *likely)]
    at = max(tried, key=lambda one: summed.gain(one, known))
    if summed.gain(at, known) < rules.STILL_CLEAR:
        at = known  # what is hardly likelier is not worth another map
    gains = np.zeros(paths.PARAMETERS)
    for k in np.flatnonzero(at):
        gains[k] = summed.gain(at, _without(evidence, at, int(k)))
    rivals.weigh([(_over(evidence, rival, given), refined) for rival, refined in of_rivals])
    for one in met:
        rivals.meet(_over(evidence, one, known), one)
    return at, gains


def weigh(evidence: Evidence, given: Floats, rivals: Rivals) -> None:
    """Add the evidence of the rows for each rival of the operators in use."""
    rivals.weigh([(_over(evidence, rival, given), rival) for rival in rivals])


def _is_brief(evidence: Evidence, at: Floats, given: Floats) -> bool:
    """Whether a new lag is within the scatter of sampling times."""
    least = rules.LEAST_LAG * float(np.median(evidence.rows[:, paths.STEP]))
    return any(at[k] and not given[k] and at[k] * AGE[k] < least for k in AGE)


def _over(evidence: Evidence, rival: Floats, given: Floats) -> float:
    """Gain of a rival over the operators in use, and over those with the noise that U has."""
    noise = evidence.of_signals[paths.NOISE_U]
    others = [given] if rival[paths.NOISE_U] else [given, with_value(given, paths.NOISE_U, noise)]
    return min(evidence.gain(rival, other) for other in others)


class Summed:
    """Evidence of a look, and of those before it."""

    def __init__(self, evidence: Evidence, rivals: Rivals) -> None:
        self.of_look, self._rivals = evidence, rivals

    def gain(self, better: Floats, than: Floats) -> float:
        """Log likelihood ratio by the rows of all looks."""
        look, before = self.of_look.gain(better, than), self._rivals.gain(better, than)
        return max(look, min(look, rules.MOST_OF_LOOK) + before)


def end_of_meter(evidence: Evidence, given: Floats) -> float:
    """Flow at which the meter ends, 0 where the rows do not need one."""
    tried = [at for at in _others(evidence, given) if at[paths.TOP] != given[paths.TOP]]
    if not tried:
        return 0.0
    at = jointly(evidence, min(tried, key=lambda at: evidence.of(at).square))
    without = given, with_value(at, paths.TOP, 0.0)
    is_clear = min(evidence.gain(at, than) for than in without) >= rules.CLEAR
    is_clear = is_clear and evidence.explains(at)
    return float(at[paths.TOP]) if is_clear else 0.0


def has_least(evidence: Evidence, given: Floats, least: float) -> bool:
    """Whether the rows need a meter that shows no flow below ``least``, and leave nothing else."""
    at = with_value(given, paths.LEAST, least)
    return evidence.gain(at, given) >= rules.CLEAR and evidence.explains(at)


def _grown(evidence: Evidence, beam: list[Floats]) -> list[Floats]:
    """The likeliest combinations of one more operator, refined, the best first."""
    scored = [
        (left, at)
        for parent in beam
        for left, at in _scored(evidence, parent, list(_others(evidence, parent)))
    ]
    return _best(evidence, scored)


def _swapped(evidence: Evidence, best: Floats) -> Floats:
    """Try those alike in the place of each operator until none is likelier."""
    improved = True
    while improved and evidence.spent < rules.MOST_TRIED:
        tried = [
            limited(with_value(best, k, 0.0), other, value)
            for group in ALIKE
            for k in group
            if best[k]
            for other in group
            if not best[other]
            for value in (*TRIED[other], *_of_age(best, k, other))
        ]
        others = _best(evidence, _scored(evidence, best, tried))
        improved = bool(others) and evidence.gain(others[0], best) > rules.LIKELIER
        best = others[0] if improved else best
    return best


def _plainest(evidence: Evidence, at: Floats) -> Floats:
    """Take play for another hysteresis where that is hardly likelier."""
    plain, *others = HYSTERESES
    for k in others:
        if at[k]:
            tried = jointly(evidence, with_value(with_value(at, k, 0.0), plain, float(at[k])))
            at = tried if evidence.gain(at, tried) < rules.STILL_CLEAR else at
    return at


def _of_age(at: Floats, k: int, other: int) -> Iterator[float]:
    """Return the value of a lag that shows flows as old as lag k does."""
    if k in AGE:
        yield float(at[k]) * AGE[k] / AGE[other]


def _scored(
    evidence: Evidence, parent: Floats, tried: list[Floats]
) -> Iterator[tuple[float, Floats]]:
    """Squares that each leaves where operators that are there as well may change a little."""
    J, ks = slopes(evidence, parent), smooth(parent)
    for at in tried:
        r = evidence.of(at).residual
        use = np.array([at[k] == parent[k] for k in ks], np.bool_)
        left = float(np.einsum("i,i->", r, r))
        if use.any():
            A = np.einsum("ij,ik->jk", J[:, use], J[:, use])
            b = np.einsum("ij,i->j", J[:, use], r)
            left -= float(np.einsum("i,i->", b, solved(A, b)))
        yield left, at


def _best(evidence: Evidence, scored: Iterable[tuple[float, Floats]]) -> list[Floats]:
    """Refine the most promising of different operators, the best first."""
    firsts: dict[bytes, tuple[float, Floats]] = {}
    for left, at in scored:
        kind = (at != 0.0).tobytes()
        if kind not in firsts or left < firsts[kind][0]:
            firsts[kind] = left, at
    promising = sorted(firsts.values(), key=lambda one: one[0])[: rules.BEAM]
    refined = [jointly(evidence, at) for _, at in promising]
    return sorted(refined, key=lambda at: evidence.of(at).square)


def _needed(summed: Summed, at: Floats, given: Floats) -> Floats:
    """Drop operators that gain too little, the least first; known ones are kept unless refuted."""
    while True:
        short = [(_surplus(summed, at, k, given), k) for k in map(int, np.flatnonzero(at))]
        if not short or min(short)[0] >= 0.0:
            return at
        at = _without(summed.of_look, at, min(short)[1])


def _without(evidence: Evidence, at: Floats, k: int) -> Floats:
    """The likeliest parameters without operator k, refined: those with it are.

    A lag that is there may take over its age; noise of U, that of which a hysteresis made it free.
    """
    without = with_value(at, k, 0.0)
    taken = [
        limited(without, int(other), at[other] + at[k] * AGE[k] / AGE[int(other)])
        for other in np.flatnonzero(without)
        if k in AGE and int(other) in AGE
    ]
    if _may_be_noise(evidence, at, k):
        taken.append(with_value(without, paths.NOISE_U, evidence.of_signals[paths.NOISE_U]))
    return jointly(evidence, min([without, *taken], key=lambda at: evidence.of(at).square))


def _may_be_noise(evidence: Evidence, at: Floats, k: int) -> bool:
    """Whether operator k, a hysteresis, may only keep the noise of U from the spool."""
    is_noisy = evidence.of_signals[paths.NOISE_U] > 0.0 and not at[paths.NOISE_U]
    return bool(k in ALIKE[0] and is_noisy)


def _surplus(summed: Summed, at: Floats, k: int, given: Floats) -> float:
    """By how much operator k gains more than it has to: a new one most, a known one nothing.

    Where rows tell that a known one has another value, they must not be likelier without it.
    """
    evidence = summed.of_look
    without = _without(evidence, at, k)
    gain = summed.gain(at, without)
    if _may_be_noise(evidence, at, k):  # whether it is needed beside noise of U, too
        noisy = with_value(at, paths.NOISE_U, evidence.of_signals[paths.NOISE_U])
        gain = max(gain, evidence.gain(noisy, with_value(noisy, k, 0.0)))
    if k == paths.NEWS and not at[paths.NOISE_U]:
        # each controller moves the next U by the noise of this Q, which is no harm
        gain = min(gain, evidence.gain(with_value(at, k, paths.PAST), without))
    if given[k] == 0.0:
        return gain - rules.CLEAR
    is_told = evidence.gain(at, with_value(at, k, float(given[k]))) >= rules.STILL_CLEAR
    return gain if is_told else gain + rules.CLEAR


def _others(evidence: Evidence, at: Floats) -> Iterator[Floats]:
    """Return the parameters with one more operator; a lag may take over age of another one."""
    for k, values in TRIED.items():
        for value in (*_within_a_step(evidence, k), *values):
            if not at[k] and _is_distinct(evidence, k, value):
                tried = with_value(at, k, value)
                for group in ALIKE[:2]:
                    if k in group:
                        tried[[other for other in group if other != k]] = 0.0
                yield tried
                for other in AGE if k in AGE else ():
                    rest = at[other] - value * AGE[k] / AGE[other]
                    if at[other] and rest > 0.0:
                        yield with_value(tried, other, rest)
    yield from _of_signals(evidence, at)
    if not at[paths.TOP]:
        for share in rules.SHARES_TOP:
            yield with_value(at, paths.TOP, float(np.quantile(evidence.Q, share)))


def _within_a_step(evidence: Evidence, k: int) -> Iterator[float]:
    """Return half a step for a lag, if it is shorter than those tried: one of a part of a step."""
    half = 0.5 * float(np.median(evidence.rows[:, paths.STEP]))
    if k in AGE and half < TRIED[k][0]:
        yield half


def _of_signals(evidence: Evidence, at: Floats) -> Iterator[Floats]:
    """Return the parameters with a signal more that is held, which is old by itself, or noisy."""
    for k, found in evidence.of_signals.items():
        if found and not at[k]:
            tried = with_value(at, k, found)
            yield tried
            if k == paths.NOISE_U:
                continue
            older = 0.5 * found if k != paths.HELD_Q else -0.5 * found
            for lag in AGE:
                if at[lag]:
                    yield with_value(tried, lag, max(at[lag] + older / AGE[lag], 0.0))


def _is_distinct(evidence: Evidence, k: int, value: float) -> bool:
    """Whether a choke leaves some Δp as they are; if not, it only scales Δp: the map does that.

    So it is where p2 is 0 throughout.
    """
    if k != paths.CHOKE:
        return True
    dp, p1 = evidence.rows[:, paths.LEFT_DP], evidence.rows[:, paths.LEFT_P1]
    whole = np.abs(dp) < value * np.maximum(p1, p1 - dp)
    return bool(np.count_nonzero(whole) >= rules.SEEN_BELOW)


def least_shown(Q: Floats, noise: float) -> tuple[float, float]:
    """Return the least flow of readings in the order of time, and the evidence for a bound there.

    0 where they show flows hardly above the noise, infinite where they show none at all.

    A flow that rises steadily from none passes all sizes. A meter with a least flow jumps over
    them, while its next reading is near the one after the jump.
    """
    sizes = np.abs(Q)
    none = 0.0 if np.count_nonzero(sizes == 0.0) >= rules.SEEN_BELOW else 4.0 * noise
    above = sizes[sizes > none]
    if not len(above):
        return math.inf, 0.0
    least = float(above.min())
    before, at, behind = sizes[:-2], sizes[1:-1], sizes[2:]
    up = (before <= none) & (at > none) & (np.abs(behind - at) < 0.5 * least)
    down = (behind <= none) & (at > none) & (np.abs(before - at) < 0.5 * least)
    if least < max(rules.LEAST_NOISES * noise, 2.0 * none):
        return 0.0, 0.0
    each = min(0.25 * (least / max(noise, 1e-9)) ** 2, rules.MOST_OF_JUMP)
    return least, each * float(np.count_nonzero(up | down))


def most_delivered(rows: Floats, noise: float) -> tuple[float, float]:
    """Return the largest flow of readings in the order of time, and the evidence for a pump's end.

    A pump at its limit holds the flow while the valve opens: the pressure drop falls instead. What
    the flow would have fallen with √Δp, or risen with U, is compared with the noise. A flow that
    differs by more than noise during that, or from the largest one, is evidence against a limit:
    where Δp falls as the valve opens, the flow has a largest value as well.
    """
    Q, U = np.abs(rows[:, paths.LEFT_Q]), np.abs(rows[:, paths.LEFT_U])
    s, width = np.sqrt(np.abs(rows[:, paths.LEFT_DP])), rules.MOST_STAY * noise
    level = float(np.median(Q[np.quantile(Q, rules.NEAR_TOP) - width <= Q]))
    is_there = np.concatenate([[False], np.abs(Q - level) < width, [False]])
    begins, ends = np.flatnonzero(np.diff(is_there)).reshape(-1, 2).T
    evidence = 0.0
    for begin, end in zip(begins, ends, strict=True):
        if end - begin >= rules.SEEN_BELOW:
            high, low = begin + np.argmax(s[begin:end]), begin + np.argmin(s[begin:end])
            fall = 1.0 - s[low] / max(s[high], 1e-9)
            rise = 1.0 - U[high] / max(U[low], 1e-9)
            size = level * min(fall, rise) / max(noise, 1e-9)
            is_even = np.var(Q[begin:end]) < rules.EXPLAINED * noise**2
            is_limit = is_even and abs(np.mean(Q[begin:end]) - level) < noise
            if size > rules.MOST_OF_JUMP:
                evidence += rules.MOST_OF_JUMP if is_limit else -rules.MOST_OF_JUMP
    return level, evidence
