"""A fit: the map from its cells, and all hyper-parameters by marginal likelihood.

    y_c = x_cᵀ(β + ζ·squares) + b_c + ε_c,   b_c ~ N(0, δ²),   ε_c ~ N(0, σ²/worth_c),
    β ~ N(0, S⁻¹),  S = Σ lam·rows (see `flow_prior`),   ζ free: with β's bends 0 the map is eq. (7)

Precisions by generalised Fellner-Schall (Wood & Fasiolo 2017): what a term explains is
γ = lam·(tr S⁻¹S_k - tr V S_k), and lam = γ / βᵀS_kβ where nothing else is known of it.
"""

import math

import numpy as np

from valvemap.model.kernels import flow_plain as plain
from valvemap.model.kernels import flow_prior as prior
from valvemap.model.kernels import flow_reading as readings
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_solve as solved
from valvemap.model.kernels.banded import factorise, invert_band
from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.kernels.flow_cells import COUNT, MEAN_Q, MEAN_S, MEAN_U, Cells
from valvemap.model.kernels.flow_slopes import Slopes, owns
from valvemap.model.kernels.flow_solve import Design, Solution
from valvemap.model.kernels.flow_spread import spread
from valvemap.model.samples import Floats, Singles

# Places in `scalars`.
LAM = 0  # prior.FAMILIES precisions
VARIANCE, MISFIT, SCALE = 4, 5, 6  # σ², δ², mean square of the flow
WITHIN, WITHIN_WEIGHT = 7, 8  # squares of samples against their own cells, and their number
NEXT, NEXT_WEIGHT = 9, 10  # products of successive ones, and their number
LAST_ERROR, COLOUR = 11, 12  # error of the last sample against its cell; φ of `flow_noise`
SCALE_WEIGHT = 13  # samples that SCALE is the mean of
FREE = 14  # parameters that the samples determine
LAST_U, LAST_S = 15, 16  # of the last sample
PLAIN = 17  # probability of eq. (7)
SCALE_BEFORE = 18  # mean square of the flow at the last fit
EVIDENCE = 19  # log marginal likelihood, but for a constant
LEAST = 20  # flow against Δp that the meter shows: its offset
FIRST_T = 21  # °C; of the first sample, NaN where it was not measured
NOW_T = 22  # °C; of the last sample that had one
STAY_X, ALIKE = 23, 24  # ln ν of the oil; stays since it became so
SURPRISE, STAYS_SEEN = 25, 26  # mean square of stays, in variances; stays it is the mean of
PAIR_ERROR = 27  # of the last stay that is to be compared, against its own cell
PAIR_PRODUCT, PAIR_SQUARE, PAIRS = 28, 29, 30  # sums over pairs of stays in different cells
SLOW = 31  # the noise's slow part, as a share of σ²
AFTER, AFTER_WEIGHT = 32, 33  # products of errors two samples apart, and their number
ERROR_BEFORE = 34  # error of the sample before the last one
REFUTED = 35  # log likelihood against the map by the first samples of cells
LEARNT_T = 36  # °C; mean over what the cells know
ZERO_SCALE = 37  # l/min; root mean square of the flow by which the meter's offset is counted
READING = 38  # numbers of `flow_reading`
MAY_HAVE_CHANGED = READING + readings.NUMBERS  # probability of a sudden change, before samples,
# since the first of the cells of `flow_begun` began; of either side
TIMING = MAY_HAVE_CHANGED + 2  # numbers of `flow_reading`, of how fast the flow changes
FLOW_BEFORE = TIMING + readings.NUMBERS  # l/min; predicted for the sample before
RATE = FLOW_BEFORE + 1  # l/min/s; from the sample before that one to it
SCALARS = RATE + 1


@inner
def outlier_weight(square: float, variance: float, width: float) -> float:
    """Probability that a residual is noise and not a meter's invention, even in ``width``."""
    regular = (1.0 - rules.OUTLIERS) * math.exp(-0.5 * square / variance)
    regular /= math.sqrt(2.0 * math.pi * variance)
    return regular / (regular + rules.OUTLIERS / width)


@kernel
def fit(
    axis_U: Axis, axis_s: Axis, cells: Cells, known: Slopes, scalars: Floats, w: Floats, v: Floats,
    theta: Singles, std: Singles, rounds: int, fresh: bool,  # noqa: FBT001 - numba knows no keyword
) -> bool:  # fmt: skip
    """Fit the map; everything but the cells is written in place. False: it could not be done.

    ``fresh``: hyper-parameters start from the first guess. There are ``rounds`` at most.
    """
    n_s, rows, scale = len(axis_s.sites), 0, scalars[SCALE]
    for c in range(len(cells)):
        if cells[c, COUNT] > 0.0:
            rows += 2 if owns(known, c) else 1
    if rows == 0 or not scale > 0.0:
        return False
    alike = 1.0 + scalars[SLOW] * (2.0 * scalars[COLOUR] ** 2 / (1.0 - scalars[COLOUR] ** 2))
    readings.estimate(scalars[READING:], scalars[WITHIN_WEIGHT], alike)
    readings.estimate(scalars[TIMING:], scalars[WITHIN_WEIGHT], alike)
    guess, lam = np.empty(prior.FAMILIES), scalars[LAM : LAM + prior.FAMILIES]
    _first_guess(axis_s, scale, guess)
    if fresh:
        lam[:] = guess
        w[:], v[:] = 1.0, 1.0
        scalars[MISFIT], scalars[VARIANCE] = rules.MISFIT**2 * scale, rules.NOISE**2 * scale
    elif scale > scalars[SCALE_BEFORE]:  # flows as large as these were not known to be there
        for f in range(prior.FAMILIES):
            lam[f] *= scalars[SCALE_BEFORE] / scale
    scalars[SCALE_BEFORE] = scale
    of, to = _room(len(axis_U.sites) * n_s, 2 * n_s + 3, rows)
    work = np.empty((4, 3))
    solved.gather(axis_U, axis_s, cells, known, scalars[READING:], work, of)
    ridge, done = 1.0 / (rules.ANYTHING**2 * scale), False
    square = 1.0 / (rules.SQUARE**2 * scale)
    for k_round in range(rounds + 1):
        done = done or k_round == rounds
        sigma2, delta2 = scalars[VARIANCE], scalars[MISFIT]
        _start(axis_U, axis_s, lam, w, v, ridge, work, to)
        solved.assemble(n_s, of, sigma2, delta2, to)
        if not solved.solve(n_s, of, square * axis_s.breaks[-1] ** 4, to):
            return False
        solved.explain(n_s, of, sigma2, delta2, to)
        if not factorise(to.A_prior, len(theta), 2 * n_s + 3):
            return False
        if done:
            break
        _weigh(n_s, of, sigma2, delta2, scale, to)
        _update_noise(scalars, to)
        done = _update_prior(axis_U, axis_s, scalars, guess, w, v, work, to)
    zeta = to.scalars[solved.ZETA]
    for p in range(len(theta)):
        theta[p] = to.beta[p] + zeta * axis_s.squares[p % n_s]
    scalars[LEAST] = _least(cells, scale)
    scalars[FREE] = to.scalars[solved.FREE]
    scalars[EVIDENCE] = _evidence(2 * n_s + 3, scale, of, scalars, to)
    left, free = to.scalars[solved.LEFT], to.scalars[solved.FREE]
    root = to.scalars[solved.ROOT]
    spread(axis_U, axis_s, to.Z, to.lifted[0], root, theta, work, std)
    if scalars[SCALE_WEIGHT] >= rules.LOOKS[0]:  # before it, fits cost most and are soon repeated
        _weigh_rougher_map(
            axis_U, axis_s, scalars, guess, w, v, ridge, square, theta, work, of, to, std
        )  # fmt: skip
    terms = np.full(plain.TERMS, ridge)
    terms[0] = terms[1] = lam[prior.ZERO]
    terms[4] = square
    scalars[PLAIN] = plain.mix(axis_U, axis_s, of, left, free, terms, theta, std)
    return True


@inner
def _least(cells: Cells, scale: float) -> float:
    """Largest flow against Δp that cells of many samples show, as a negative number."""
    least = 0.0
    for c in range(len(cells)):
        if cells[c, COUNT] >= rules.SURE_CELL:
            towards = cells[c, MEAN_S] * (1.0 if cells[c, MEAN_U] >= 0.0 else -1.0)
            least = min(least, math.copysign(1.0, towards) * cells[c, MEAN_Q])
    return max(least, -rules.ZERO_FLOW * math.sqrt(scale))


@inner
def _first_guess(axis_s: Axis, scale: float, lam: Floats) -> None:
    """Precisions of the prior before anything is known but the flow's mean square."""
    top = axis_s.breaks[-1]
    lam[prior.BEND] = (0.5 * top / rules.BEND) ** 2 / scale
    lam[prior.CURVE] = top**3 / (rules.CURVE**2 * scale)
    lam[prior.TWIST] = top**3 / (rules.TWIST**2 * scale)
    lam[prior.ZERO] = 1.0 / (rules.ZERO_FLOW**2 * scale)


@maker
def _room(n: int, band: int, rows: int) -> tuple[Design, Solution]:
    """Arrays for n parameters and ``rows`` of the design."""
    of = Design(
        np.empty(rows, np.int64), np.empty((rows, 9)), np.empty(rows), np.empty(rows),
        np.empty(rows), np.empty(rows), np.empty(rows),
    )  # fmt: skip
    to = Solution(
        np.empty(n * band), np.empty(n * band), np.empty(n * (2 * band - 1)),
        np.empty(n * (2 * band - 1)), np.empty((2, n)), np.empty(n), np.empty((1, n)),
        np.zeros(solved.SOLVED),
    )  # fmt: skip
    return of, to


@maker
def _start(
    axis_U: Axis, axis_s: Axis, lam: Floats, w: Floats, v: Floats, ridge: float, work: Floats,
    to: Solution,
) -> None:  # fmt: skip
    """Begin a round: the prior alone."""
    to.A_prior[:], to.Y[:] = 0.0, 0.0
    prior.add(axis_U, axis_s, lam, w, v, work[:2], to.A_prior)
    for p in range(len(to.beta)):
        to.A_prior[p * (2 * len(axis_s.sites) + 3)] += ridge
    to.A[:] = to.A_prior


@inner
def _weigh(n_s: int, of: Design, sigma2: float, delta2: float, scale: float, to: Solution) -> None:
    """How likely cells of few samples are to have begun with an outlier."""
    for k in range(len(of.y)):
        if of.worth[k] < rules.FEW:
            residual, own = solved.residual_of(n_s, of, k, to)
            doubt = delta2 + sigma2 / of.worth[k] + own
            of.regular[k] = outlier_weight(residual * residual, doubt, _width(of.worth[k], scale))


@inner
def _width(worth: float, scale: float) -> float:
    """Width of the even density of what a cell of few samples shows where it is an outlier."""
    return float(rules.OUTLIER_WIDTH * math.sqrt(scale) / max(worth, 1.0))


@inner
def _update_noise(scalars: Floats, to: Solution) -> None:
    sigma2, delta2, said = scalars[VARIANCE], scalars[MISFIT], to.scalars
    squares = said[solved.NOISE] + scalars[WITHIN] + rules.FREEDOM_NOISE * sigma2
    used = said[solved.NOISE_USED] + scalars[WITHIN_WEIGHT] + rules.FREEDOM_NOISE
    scalars[VARIANCE] = _towards(squares / used, sigma2)
    squares = said[solved.MISFIT] + rules.FREEDOM_MISFIT * rules.LEAST_MISFIT**2 * sigma2
    scalars[MISFIT] = _towards(squares / (said[solved.MISFIT_USED] + rules.FREEDOM_MISFIT), delta2)


@maker
def _update_prior(
    axis_U: Axis, axis_s: Axis, scalars: Floats, guess: Floats, w: Floats, v: Floats, work: Floats,
    to: Solution,
) -> bool:  # fmt: skip
    """Move the prior's precisions; True where they have settled."""
    n_U, n_s, lam = len(axis_U.sites), len(axis_s.sites), scalars[LAM : LAM + prior.FAMILIES]
    found_U, found_s = np.empty((2, n_U - 2, 2)), np.empty((n_s - 2, 2))
    totals = np.empty((prior.FAMILIES, 2))
    invert_band(to.A_prior, len(to.beta), 2 * n_s + 3, to.Z_prior)
    prior.forms(
        axis_U, axis_s, to.beta, to.lifted, to.Z, to.Z_prior, work[:2], found_U, found_s, totals,
        w, v,
    )  # fmt: skip
    for i in range(n_U - 2):
        square = lam[prior.BEND] * found_U[0, i, 0] + lam[prior.TWIST] * found_U[1, i, 0]
        used = lam[prior.BEND] * found_U[0, i, 1] + lam[prior.TWIST] * found_U[1, i, 1]
        w[i] = (rules.FREEDOM_U + w[i] * used) / (rules.FREEDOM_U + square)
    for j in range(n_s - 2):
        square, used = lam[prior.CURVE] * found_s[j, 0], lam[prior.CURVE] * found_s[j, 1]
        v[j] = (rules.FREEDOM_S + v[j] * used) / (rules.FREEDOM_S + square)
    moved = 0.0
    for f in range(prior.FAMILIES):
        most = guess[f] if f == prior.ZERO else rules.FLAT * guess[f]
        used = rules.FREEDOM_LEVEL + lam[f] * totals[f, 1]
        wanted = min(used / (rules.FREEDOM_LEVEL / most + totals[f, 0]), most)
        moved = max(moved, abs(math.log(wanted / lam[f])))
        lam[f] = _towards(wanted, lam[f])
    return moved < rules.SETTLED


@maker
def _weigh_rougher_map(
    axis_U: Axis, axis_s: Axis, scalars: Floats, guess: Floats, w: Floats, v: Floats, ridge: float,
    square: float, theta: Singles, work: Floats, of: Design, to: Solution, std: Singles,
) -> None:  # fmt: skip
    """Widen ``std`` by a rougher map, as far as the cells allow it: precisions are not known.

    Samples of a small part of the range hardly tell how much the map bends elsewhere. The rougher
    map lies halfway between the likeliest and the first guess, where that is rougher.
    """
    n_s, other = len(axis_s.sites), np.empty_like(std)
    sigma2, delta2 = scalars[VARIANCE], scalars[MISFIT]
    for f in range(prior.FAMILIES):
        guess[f] = math.sqrt(scalars[LAM + f] * min(guess[f], scalars[LAM + f]))
    _start(axis_U, axis_s, guess, w, v, ridge, work, to)
    solved.assemble(n_s, of, sigma2, delta2, to)
    if not solved.solve(n_s, of, square * axis_s.breaks[-1] ** 4, to):
        return
    solved.explain(n_s, of, sigma2, delta2, to)
    if not factorise(to.A_prior, len(theta), 2 * n_s + 3):
        return
    lost = scalars[EVIDENCE] - _evidence(2 * n_s + 3, scalars[SCALE], of, scalars, to)
    share = 1.0 / (1.0 + math.exp(min(max(lost, -50.0), 50.0)))
    zeta, root = to.scalars[solved.ZETA], to.scalars[solved.ROOT]
    spread(axis_U, axis_s, to.Z, to.lifted[0], root, theta, work, other)
    for p in range(len(theta)):
        off = to.beta[p] + zeta * axis_s.squares[p % n_s] - theta[p]
        wide = other[p] ** 2 + off * off
        std[p] = math.sqrt((1.0 - share) * std[p] ** 2 + share * wide)


@inner
def _towards(wanted: float, before: float) -> float:
    """A step towards what is wanted: farther, as such steps fall short, but bounded."""
    step = (wanted / before) ** rules.HASTE
    return float(before * min(max(step, 1.0 / rules.MOST_STEP), rules.MOST_STEP))


@inner
def _evidence(band: int, scale: float, of: Design, scalars: Floats, to: Solution) -> float:
    """Log marginal likelihood of the cells, outliers among them, and of the samples within them."""
    total = to.scalars[solved.EVIDENCE]
    for k in range(len(of.y)):  # without it a map that refuses its cells would be the likeliest
        if of.regular[k] < 1.0:
            outlier = rules.OUTLIERS / _width(of.worth[k], scale) * math.sqrt(2.0 * math.pi)
            total += (1.0 - of.regular[k]) * math.log(outlier)
    for p in range(len(to.beta)):
        total += math.log(to.A_prior[p * band])
    sigma2 = scalars[VARIANCE]
    within = scalars[WITHIN] / sigma2 + scalars[WITHIN_WEIGHT] * math.log(sigma2)
    return float(total - 0.5 * within)
