"""Errata of least squares, eqs. (8)-(28), and of the text about them."""

from collections.abc import Iterator

import numpy as np

from paper import printed
from paper.data import PaperData
from paper.erratum import ROUNDING, Erratum
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.samples import Floats

LAM = 0.97
N = 300
FEW = 20


def of_least_squares(data: PaperData) -> Iterator[Erratum]:
    """Evaluate all errata of eqs. (8) to (28) on the first samples of the scattered recording."""
    samples = data.scattered[:N]
    X, y = FiveTerms().regressors(samples.U, samples.dp, samples.T), samples.Q
    yield from _stacking(X, y)
    yield _gradient(X, y)
    yield _indices(X)
    yield _start(X, y)
    yield _weights(X, y)
    yield from _information(X, y)
    yield _lam_squared(X, y)
    yield _meaning_of_P(X)
    yield _units(X, y)
    yield _fluctuation(data)


def _stacking(X: Floats, y: Floats) -> Iterator[Erratum]:
    n = X.shape[1]
    rows, columns = [row[None, :] for row in X], [row[:, None] for row in X]
    right, as_printed = np.vstack(rows), np.vstack(columns)
    yield Erratum(
        "before (13), (22)",
        "X_t = [Xᵀ(1) Xᵀ(2) … Xᵀ(t)]ᵀ, one column of t·n numbers",
        "X_t has the rows Xᵀ(i): t × n",
        f"columns that are not there, of the {n} that θ needs in X_t·θ",
        float(n - as_printed.shape[1]),
        float(n - right.shape[1]),
        0.0,
        "the product must exist",
    )
    before, now = y[:-1, None], y[-1:, None]
    yield Erratum(
        "before (22), Q",
        "Q_P,t = [Q_P,t−1 Q_P(t)], without inner transposes",
        "Q_P,t = [Qᵀ_P,t−1 Q_P(t)]ᵀ, one column",
        "rows of the blocks that do not match where they are put side by side, or columns where "
        "they are put below each other",
        float(abs(before.shape[0] - now.shape[0])),
        float(abs(before.shape[1] - now.shape[1])),
        0.0,
        "the matrix must exist",
    )


def _gradient(X: Floats, y: Floats) -> Erratum:
    estimate = batch_least_squares(X, y)
    at_rest = np.abs(X.T @ (y - X @ estimate)).max()
    elsewhere = np.abs(X.T @ (y - X @ (1.01 * estimate))).max()
    size = float(np.abs(X.T @ y).max())
    return Erratum(
        "(15)",
        "∂J/∂θ = −2·Xᵀ(Q − Xθ) = 0, for any θ",
        "= 0 at θ̂ alone",
        "largest |Xᵀ(Q − Xθ)| over |XᵀQ|, at θ 1 % beside θ̂, and at θ̂",
        float(elsewhere / size),
        float(at_rest / size),
        *ROUNDING,
    )


def _indices(X: Floats) -> Erratum:
    t = len(X) // 2
    grown = X[:t].T @ X[:t]
    # The sum binds t, so the t on the left has no effect: the sum includes all data.
    bound = sum((np.outer(x, x) for x in X), start=np.zeros_like(grown))
    free = sum((np.outer(x, x) for x in X[:t]), start=np.zeros_like(grown))
    return Erratum(
        "(11), (14), (16), (17), (26)",
        "t is both the running index of the sums and their end",
        "Σ from i = 1 to t of X(i)·Xᵀ(i)",
        f"largest relative error of P⁻¹(t) after t = {t} of {len(X)} samples",
        _distance(bound, grown),
        _distance(free, grown),
        *ROUNDING,
    )


def _start(X: Floats, y: Floats) -> Erratum:
    exact = batch_least_squares(X[:FEW], y[:FEW])
    return Erratum(
        "(18)",
        "P(0) = P₀·I with a finite P₀, here 1",
        "P₀ = ∞: a finite one is ridge regression, not (16)",
        f"largest relative distance of θ from (16) after {FEW} samples",
        _distance(recursive_least_squares(X[:FEW], y[:FEW], p0=1.0).theta, exact),
        _distance(recursive_least_squares(X[:FEW], y[:FEW]).theta, exact),
        *ROUNDING,
    )


def _weights(X: Floats, y: Floats) -> Erratum:
    w = np.sqrt(_lams(len(y)))
    half, full = (batch_least_squares(X * w[:, None], z) for z in (y, y * w))
    return Erratum(
        "before (26)",
        "only X is weighted by √λ",
        "Q is weighted by √λ too",
        f"largest relative distance from recursive least squares with λ = {LAM:g}",
        _distance(half, recursive_least_squares(X, y, LAM).theta),
        _distance(full, recursive_least_squares(X, y, LAM).theta),
        *ROUNDING,
    )


def _information(X: Floats, y: Floats) -> Iterator[Erratum]:
    x, weights = X[-1], _lams(len(X))
    now = (X.T * weights) @ X
    before = (X[:-1].T * weights[1:]) @ X[:-1]
    yield Erratum(
        "(26)",
        "P^λ = P⁻¹(t−1)/λ + X·Xᵀ, sums without λ^(t−i)",
        "P⁻¹(t) = λ·P⁻¹(t−1) + X·Xᵀ",
        f"largest relative error of P⁻¹(t), λ = {LAM:g}",
        _distance(before / LAM + np.outer(x, x), now),
        _distance(LAM * before + np.outer(x, x), now),
        *ROUNDING,
    )
    earlier = recursive_least_squares(X[:-1], y[:-1], LAM)
    step = recursive_least_squares(X, y, LAM)
    gain = (step.theta - earlier.theta) / step.innovations[-1]
    P = np.asarray(np.linalg.inv(before), np.float64)

    def of(P_lam: Floats) -> Floats:
        return np.asarray(P_lam @ x / (1.0 + x @ P_lam @ x))

    yield Erratum(
        "(27)",
        "P^λ(t−1) = P⁻¹(t−1)/λ",
        "P^λ(t−1) = P(t−1)/λ",
        "largest relative error of the gain that (25) then gives",
        _distance(of(before / LAM), gain),
        _distance(of(P / LAM), gain),
        *ROUNDING,
    )


def _lam_squared(X: Floats, y: Floats) -> Erratum:
    exact = batch_least_squares(X, y, LAM)
    theta = printed.least_squares(X, y, LAM)[-1]
    squared = _distance(theta, batch_least_squares(X, y, LAM**2))
    return Erratum(
        "(28)",
        "L = P^λX/(λ + XᵀP^λX) with P^λ = P/λ: λ counts twice",
        "L = PX/(λ + XᵀPX), P = (P − L·XᵀP)/λ",
        f"largest relative distance from batch least squares with λ = {LAM:g} "
        f"(printed: {squared:.1g} from that with λ² = {LAM**2:.4g})",
        _distance(theta, exact),
        _distance(recursive_least_squares(X, y, LAM).theta, exact),
        *ROUNDING,
    )


def _meaning_of_P(X: Floats) -> Erratum:
    rng, sigma, runs = np.random.default_rng(1), 2.0, 2_000
    noise = sigma * rng.normal(size=(len(X), runs))
    errors = np.linalg.lstsq(X, noise, rcond=None)[0]
    measured = np.diag(np.cov(errors))
    information = X.T @ X
    return Erratum(
        "nomenclature, P",
        "P is the 'data matrix', Σ X·Xᵀ",
        "σ²·P is the covariance of θ̂, P = (Σ X·Xᵀ)⁻¹",
        f"largest relative error of σ²·P as variance of θ̂ in {runs:,} runs",
        _distance(sigma**2 * np.diag(information), measured),
        _distance(sigma**2 * np.diag(np.linalg.inv(information)), measured),
        0.15,
        f"four standard errors of a variance from {runs:,} runs",
    )


def _units(X: Floats, y: Floats) -> Erratum:
    """Evaluate a change of units, from % and bar to a signal of 10 V and to MPa."""
    theta = batch_least_squares(X, y)
    volts, root_MPa = 0.1, np.sqrt(0.1)
    factor = np.array([1.0, volts, root_MPa, volts * root_MPa, root_MPa**2])
    other = batch_least_squares(X * factor, y)
    return Erratum(
        "nomenclature, a_i and U",
        "a_i have no unit; U in V or in %",
        "a₂ in l/(min·%), a₃ in l/(min·√bar), …; U in %",
        "largest relative change of a_i when U is in V (0 to 10) and Δp in MPa: as they stand, "
        "and with their units converted",
        _distance(other, theta),
        _distance(other * factor, theta),
        *ROUNDING,
    )


def _fluctuation(data: PaperData) -> Erratum:
    samples = data.scattered
    X, y = FiveTerms().regressors(samples.U, samples.dp, samples.T), samples.Q
    lams = (0.95, 0.98, 0.99, 0.995, 0.999, 1.0)
    late = slice(len(y) // 2, None)
    swing = np.array(
        [recursive_least_squares(X, y, lam).theta_history[late, 3].std() for lam in lams]
    )
    grows = np.diff(swing) > 0.0
    return Erratum(
        "section 4, text",
        "fluctuation grows 'during increase of forgetting factor'",
        "it grows as λ decreases",
        f"steps from λ = {lams[0]:g} to {lams[-1]:g} at which a₄ does otherwise, of {len(grows)} "
        f"(its standard deviation falls from {swing[0]:.2g} to {swing[-1]:.2g})",
        float((~grows).sum()),
        float(grows.sum()),
        0.0,
        "every step must do as the sentence says",
    )


def _lams(n: int) -> Floats:
    return np.asarray(LAM ** np.arange(n - 1, -1, -1.0))


def _distance(a: Floats, b: Floats) -> float:
    with np.errstate(all="ignore"):
        return float(np.max(np.abs(a - b) / np.abs(b)))
