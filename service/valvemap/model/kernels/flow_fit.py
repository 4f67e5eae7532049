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
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.banded import factorise, invert_band, substitute
from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.kernels.flow_basis import Axis, interval, values
from valvemap.model.kernels.flow_cells import COUNT, MEAN_Q, WORTH, Cells, design
from valvemap.model.samples import Floats, Singles

# Places in `scalars`.
LAM = 0  # prior.FAMILIES precisions
VARIANCE, MISFIT, SCALE = 5, 6, 7  # σ², δ², mean square of the flow
WITHIN, WITHIN_WEIGHT = 8, 9  # squares of samples against their own cells, and their number
NEXT, NEXT_WEIGHT = 10, 11  # products of successive ones, and their number
LAST_ERROR, COLOUR = 12, 13  # error of the last sample against its cell; ρ
MEAN_SQUARE_WEIGHT = 14
FREE = 15  # parameters that the samples determine
LAST_U, LAST_S = 16, 17  # of the last sample
PLAIN = 18  # probability of eq. (7)
SCALE_BEFORE = 19  # mean square of the flow at the last fit
SCALARS = 24


@inner
def outlier_weight(square: float, variance: float, width: float) -> float:
    """Probability that a residual is noise and not a meter's invention, even in ``width``."""
    regular = (1.0 - rules.OUTLIERS) * math.exp(-0.5 * square / variance)
    regular /= math.sqrt(2.0 * math.pi * variance)
    return regular / (regular + rules.OUTLIERS / width)


@inner
def first_guess(axis_s: Axis, scale: float, lam: Floats) -> None:
    """Precisions of the prior before anything is known but the flow's mean square."""
    top = axis_s.breaks[-1]
    lam[prior.BEND] = (0.5 * top / rules.BEND) ** 2 / scale
    lam[prior.CURVE] = top**3 / (rules.CURVE**2 * scale)
    lam[prior.TWIST] = top**3 / (rules.TWIST**2 * scale)
    lam[prior.ZERO] = 1.0 / (rules.ZERO_FLOW**2 * scale)
    lam[prior.CLOSED] = 1.0 / (rules.CLOSED_FLOW**2 * scale)


@kernel
def fit(
    axis_U: Axis, axis_s: Axis, cells: Cells, scalars: Floats, w: Floats, v: Floats,
    theta: Floats, std: Singles, rounds: int, fresh: bool,  # noqa: FBT001 - numba knows no keyword
) -> bool:  # fmt: skip
    """Fit the map; everything but the cells is written in place. False: it could not be done.

    ``fresh``: hyper-parameters start from the first guess.
    """
    n_U, n_s = len(axis_U.sites), len(axis_s.sites)
    n, band = n_U * n_s, 2 * n_s + 3
    known = 0
    for c in range(len(cells)):
        if cells[c, COUNT] > 0.0:
            known += 1
    scale = scalars[SCALE]
    if known == 0 or not scale > 0.0:
        return False
    guess = np.empty(prior.FAMILIES)
    first_guess(axis_s, scale, guess)
    lam = scalars[LAM : LAM + prior.FAMILIES]
    if fresh:
        lam[:] = guess
        w[:], v[:] = 1.0, 1.0
        scalars[MISFIT] = rules.MISFIT**2 * scale
        scalars[VARIANCE] = rules.NOISE**2 * scale
    elif scale > scalars[SCALE_BEFORE]:  # flows as large as these were not known to be there
        for f in range(prior.FAMILIES):
            lam[f] *= scalars[SCALE_BEFORE] / scale
    scalars[SCALE_BEFORE] = scale
    lam[prior.ZERO], lam[prior.CLOSED] = guess[prior.ZERO], guess[prior.CLOSED]
    rows, firsts = np.empty((known, 9)), np.empty(known, np.int64)
    y, worth, border_row = np.empty(known), np.empty(known), np.empty(known)
    regular, precisions = np.ones(known), np.empty(known)
    work = np.empty((4, 3))
    k = 0
    for c in range(len(cells)):
        if cells[c, COUNT] > 0.0:
            firsts[k] = design(axis_U, axis_s, cells[c], c, work, rows[k])
            y[k], worth[k] = cells[c, MEAN_Q], cells[c, WORTH]
            border_row[k] = 0.0
            for a in range(3):
                for b in range(3):
                    square = axis_s.squares[firsts[k] % n_s + b]
                    border_row[k] += rows[k, 3 * a + b] * square
            k += 1
    A, A_prior = np.empty(n * band), np.empty(n * band)
    Z, Z_prior = np.empty(n * (2 * band - 1)), np.empty(n * (2 * band - 1))
    Y = np.empty((2, n))
    beta, lifted = np.empty(n), np.empty((1, n))
    found_U, found_s = np.empty((2, n_U - 2, 2)), np.empty((n_s - 2, 2))
    totals = np.empty((prior.FAMILIES, 2))
    top = axis_s.breaks[-1] ** 2
    free_border = top * top / (rules.ANYTHING**2 * scale)  # precision of ζ
    ridge = 1.0 / (rules.ANYTHING**2 * scale)
    zeta = 0.0
    last = rounds
    for k_round in range(rounds + 1):
        sigma2, delta2 = scalars[VARIANCE], scalars[MISFIT]
        A_prior[:] = 0.0
        prior.add(axis_U, axis_s, lam, w, v, work[:2], A_prior)
        for p in range(n):
            A_prior[p * band] += ridge
        A[:] = A_prior
        Y[:] = 0.0
        corner, of_border = free_border, 0.0
        for k in range(known):
            precision = regular[k] / (delta2 + sigma2 / worth[k])
            first = firsts[k]
            for a in range(3):
                for b in range(3):
                    p, x = a * n_s + b, precision * rows[k, 3 * a + b]
                    Y[0, first + p] += x * y[k]
                    Y[1, first + p] += x * border_row[k]
                    at = (first + p) * band
                    for d in range(b, 3):
                        A[at + d - b] += x * rows[k, 3 * a + d]
                    for c in range(a + 1, 3):
                        for d in range(3):
                            A[at + (c - a) * n_s + d - b] += x * rows[k, 3 * c + d]
            corner += precision * border_row[k] ** 2
            of_border += precision * border_row[k] * y[k]
        lifted[0] = Y[1]
        if not factorise(A, n, band):
            return False
        substitute(A, band, Y)
        for p in range(n):
            corner -= lifted[0, p] * Y[1, p]
            of_border -= lifted[0, p] * Y[0, p]
        corner = max(corner, free_border * 1e-9)
        zeta = of_border / corner
        root = 1.0 / math.sqrt(corner)
        for p in range(n):
            beta[p] = Y[0, p] - zeta * Y[1, p]
            lifted[0, p] = root * Y[1, p]
        invert_band(A, n, band, Z)
        # σ², δ², and which cells are outliers.
        explained_noise, noise, explained_misfit, misfit = 0.0, 0.0, 0.0, 0.0
        free, least = 0.0, 0.0
        for k in range(known):
            first, fitted, own, along = firsts[k], 0.0, 0.0, 0.0
            for a in range(3):
                for b in range(3):
                    p = a * n_s + b
                    x = rows[k, 3 * a + b]
                    fitted += x * beta[first + p]
                    along += x * lifted[0, first + p]
                    here = (first + p) * (2 * band - 1) + band - 1
                    for c in range(3):
                        for d in range(3):
                            own += x * rows[k, 3 * c + d] * Z[here + (c - a) * n_s + d - b]
            fitted += zeta * border_row[k]
            own += (root * border_row[k] - along) ** 2
            residual, of_noise = y[k] - fitted, sigma2 / worth[k]
            variance = delta2 + of_noise
            precision = regular[k] / variance
            left = precision * max(1.0 - precision * own, 0.0)
            free += precision * own
            least += precision * residual * residual
            precisions[k] = precision
            noise += regular[k] * worth[k] * (of_noise / variance * residual) ** 2
            explained_noise += of_noise * left
            misfit += regular[k] * (delta2 / variance * residual) ** 2
            explained_misfit += delta2 * left
            if k_round < last:
                if worth[k] < rules.FEW:  # it may have begun with an outlier
                    width = rules.OUTLIER_WIDTH * math.sqrt(scale) / max(worth[k], 1.0)
                    regular[k] = outlier_weight(residual * residual, variance + own, width)
        scalars[FREE] = free
        if k_round >= last:
            break
        noise += scalars[WITHIN] + rules.FREEDOM_NOISE * sigma2
        explained_noise += scalars[WITHIN_WEIGHT] + rules.FREEDOM_NOISE
        scalars[VARIANCE] = _within(noise / explained_noise, sigma2)
        misfit += rules.FREEDOM_MISFIT * rules.LEAST_MISFIT**2 * sigma2
        explained_misfit += rules.FREEDOM_MISFIT
        scalars[MISFIT] = _within(misfit / explained_misfit, delta2)
        # The prior's precisions.
        if not factorise(A_prior, n, band):
            return False
        invert_band(A_prior, n, band, Z_prior)
        prior.forms(
            axis_U, axis_s, beta, lifted, Z, Z_prior, work[:2], found_U, found_s, totals, w, v
        )
        for i in range(n_U - 2):
            square = lam[prior.BEND] * found_U[0, i, 0] + lam[prior.TWIST] * found_U[1, i, 0]
            used = lam[prior.BEND] * found_U[0, i, 1] + lam[prior.TWIST] * found_U[1, i, 1]
            w[i] = (rules.FREEDOM_U + w[i] * used) / (rules.FREEDOM_U + square)
        for j in range(n_s - 2):
            square, used = lam[prior.CURVE] * found_s[j, 0], lam[prior.CURVE] * found_s[j, 1]
            v[j] = (rules.FREEDOM_S + v[j] * used) / (rules.FREEDOM_S + square)
        moved = 0.0
        for f in (prior.BEND, prior.CURVE, prior.TWIST):
            used = rules.FREEDOM_LEVEL + lam[f] * totals[f, 1]
            least = rules.FREEDOM_LEVEL / (rules.FLAT * guess[f])
            wanted = used / (least + totals[f, 0])
            moved = max(moved, abs(math.log(wanted / lam[f])))
            lam[f] = _within(wanted, lam[f])
        if moved < rules.SETTLED:
            last = k_round + 1
    for p in range(n):
        theta[p] = beta[p] + zeta * axis_s.squares[p % n_s]
    _spread(axis_U, axis_s, Z, lifted[0], root, theta, work, std)
    scalars[PLAIN] = plain.mix(
        axis_U, axis_s, firsts, rows, y, precisions, least, scalars[FREE], theta, std
    )
    return True


@inner
def _within(wanted: float, before: float) -> float:
    """A step towards what is wanted: farther, as such steps fall short, but bounded."""
    step = (wanted / before) ** rules.HASTE
    return float(before * min(max(step, 1.0 / rules.MOST_STEP), rules.MOST_STEP))


@inner
def _spread(
    axis_U: Axis, axis_s: Axis, Z: Floats, lifted: Floats, root: float, theta: Floats,
    work: Floats, std: Singles,
) -> None:  # fmt: skip
    """Standard deviation of the map at the sites: of its coefficients, and below its knots."""
    n_U, n_s = len(axis_U.sites), len(axis_s.sites)
    band = 2 * n_s + 3
    for i in range(n_U):
        u = min(max(axis_U.sites[i], axis_U.breaks[0]), axis_U.breaks[-1])
        at_U = interval(axis_U, u)
        values(axis_U, at_U, u, 0.0, work[0])
        for j in range(n_s):
            s = min(max(axis_s.sites[j], axis_s.breaks[0]), axis_s.breaks[-1])
            at_s = interval(axis_s, s)
            values(axis_s, at_s, s, 0.0, work[1])
            first, total, along = at_U * n_s + at_s, 0.0, 0.0
            for a in range(3):
                for b in range(3):
                    p, x = first + a * n_s + b, work[0, a] * work[1, b]
                    along += x * (root * axis_s.squares[at_s + b] - lifted[p])
                    here = p * (2 * band - 1) + band - 1
                    for c in range(3):
                        for d in range(3):
                            y = x * work[0, c] * work[1, d]
                            total += y * Z[here + (c - a) * n_s + d - b]
            total += along * along
            knee_U, knee_s = 0.0, 0.0
            for k in range(max(i - 2, 0), min(i + 2, n_U - 3)):
                at = k * n_s + j
                third = (
                    theta[at + 3 * n_s] - theta[at] + 3.0 * (theta[at + n_s] - theta[at + 2 * n_s])
                )
                knee_U = max(knee_U, abs(third))
            for k in range(max(j - 2, 0), min(j + 2, n_s - 3)):
                jump = _curvature(axis_s, theta, i * n_s, k + 1) - _curvature(
                    axis_s, theta, i * n_s, k
                )
                knee_s = max(knee_s, abs(jump) * (axis_s.sites[k + 2] - axis_s.sites[k + 1]) ** 2)
            total += rules.BELOW_KNOTS**2 * (knee_U * knee_U + knee_s * knee_s)
            std[i * n_s + j] = math.sqrt(max(total, 0.0))


@inner
def _curvature(axis_s: Axis, theta: Floats, row: int, k: int) -> float:
    """Second derivative along s, about."""
    bend = 0.0
    for b in range(3):
        bend += axis_s.bends[k, b] * theta[row + k + b]
    return bend / math.sqrt(0.5 * (axis_s.sites[k + 2] - axis_s.sites[k]))
