"""Loops of recursive maximum likelihood, eq. (29), one sample after another in fixed order.

The covariance is kept as P = U·diag(D)·Uᵀ (U unit upper triangular, Bierman 1977): it cannot lose
symmetry or sign. Beside RML runs plain RLS on the same regressors without the noise columns; where
RML predicts worse than it for long, RML starts again from it.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from service.identification.samples import Codes, Floats

# Elements of ``monitor``.
LAM, COUNT, SINCE, RESTARTS, DETERMINED, WEIGHT, WEIGHT_SQUARED, RSS = range(8)
POWER, RLS_POWER, OUTPUT_POWER = range(8, 11)
MONITORS = 11

# Statuses, as in service.identification.samples.Status.
OK, WARMING_UP, UNEXCITED, REJECTED, HELD = 0, 1, 2, 3, 5

RAMP_START = 0.95  # lambda(0)
RAMP_RATE = 0.99  # lambda(t) = .99·lambda(t-1) + .01·lambda
NOISE_PRIOR = 0.1  # variance of d before the first sample, in units of the noise variance
UNDETERMINED = 1e-2  # share of the prior variance above which a direction counts as unknown
LARGEST = 1e30  # input beyond it is held off: its square would leave the range of numbers
LARGEST_RESULT = 1e100
HALVINGS = 12
PATIENCE = 200  # samples before RML may be judged against plain RLS
ROUNDING = 1e-18  # of the output's power: below it two models are equally exact


@njit(cache=True)
def is_stable(
    d: Floats,
    radius: float,
) -> bool:
    """Whether all roots of z^m + d1·z^(m-1) + ... + dm lie inside ``radius`` (Schur-Cohn)."""
    m = len(d)
    a = np.empty(m + 1)
    a[0] = 1.0
    shrink = 1.0
    for i in range(m):
        shrink /= radius
        a[i + 1] = d[i] * shrink
    b = np.empty(m + 1)
    for k in range(m, 0, -1):
        reflection = a[k]
        if not abs(reflection) < 1.0:
            return False
        b[: k + 1] = a[: k + 1]
        for i in range(k):
            a[i] = (b[i] - reflection * b[k - i]) / (1.0 - reflection * reflection)
    return True


@njit(cache=True)
def root_margins(
    d: Floats,
) -> Floats:
    """1 - max|root of D| for each of N polynomials, rows of ``d`` (N, nd), to 1e-9."""
    margins = np.ones(len(d))
    for t in range(len(d)):
        low = 0.0
        high = 1.0
        while not is_stable(d[t], high) and high < 1e12:
            low = high
            high *= 2.0
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            if is_stable(d[t], middle):
                high = middle
            else:
                low = middle
        margins[t] = 1.0 - high
    return margins


@njit(cache=True)
def _measure(
    U: Floats,
    D: Floats,
    x: Floats,
    lam: float,
    gain: Floats,
    f: Floats,
) -> float:
    """Bierman's measurement update of U, D in place; the gain is gain/alpha, alpha is returned."""
    n = len(x)
    alpha = lam
    for j in range(n):
        s = x[j]
        for i in range(j):
            s += U[i, j] * x[i]
        f[j] = s
    for j in range(n):
        g = D[j] * f[j]
        grown = alpha + f[j] * g
        D[j] *= alpha / grown
        p = -f[j] / alpha
        gain[j] = g
        for i in range(j):
            u = U[i, j]
            U[i, j] = u + gain[i] * p
            gain[i] += g * u
        alpha = grown
    return alpha


@njit(cache=True)
def _forget(
    U: Floats,
    D: Floats,
    lam: float,
    ceiling: Floats,
    ns: int,
) -> tuple[bool, float]:
    """P/lam, unless a variance would pass its ceiling: then P is held.

    Returns whether it was held, and the largest share of its ceiling among the first ``ns``.
    """
    n = len(D)
    largest = 0.0
    share = 0.0
    for i in range(n):
        variance = D[i]
        for j in range(i + 1, n):
            variance += D[j] * U[i, j] * U[i, j]
        if ceiling[i] > 0.0:
            largest = max(largest, variance / ceiling[i])
            if i < ns:
                share = largest
    if largest > lam:
        return lam < 1.0, share
    for i in range(n):
        D[i] /= lam
    return False, share / lam


@njit(cache=True)
def _push(
    raw: Floats,
    filtered: Floats,
    c: int,
    value: float,
    d: Floats,
) -> None:
    """Shift a value into channel c's memory, and value/D(q) into its filtered memory."""
    s = value
    for i in range(len(d)):
        s -= d[i] * filtered[c, i]
    for i in range(raw.shape[1] - 1, 0, -1):
        raw[c, i] = raw[c, i - 1]
        filtered[c, i] = filtered[c, i - 1]
    raw[c, 0] = value
    filtered[c, 0] = s


@njit(cache=True)
def update(
    y: Floats,
    X: Floats,
    use: NDArray[np.bool_],
    orders: NDArray[np.int64],
    lam: float,
    radius: float,
    ceiling: Floats,
    theta: Floats,
    U: Floats,
    D: Floats,
    rls_theta: Floats,
    rls_U: Floats,
    rls_D: Floats,
    raw: Floats,
    filtered: Floats,
    monitor: Floats,
    predicted: Floats,
    posterior: Floats,
    leverage: Floats,
    status: Codes,
    history: Floats,
) -> None:
    """Take N samples in; state and output arrays are changed in place.

    Row t of ``X`` is what the inputs were *before* y(t): u(t-1) of an ARMAX model, X(t) of a
    static map; ``orders`` counts the lags of y, of each input, and of the noise. Where ``use``
    is false theta is held, and a y that is missing is replaced by its prediction.
    """
    n = len(theta)
    channels = len(orders)
    nd = orders[channels - 1]
    ns = n - nd
    settled = 2 * n + 10
    h = np.zeros(n)
    hf = np.zeros(n)
    f = np.zeros(n)
    gain = np.zeros(n)
    rls_f = np.zeros(ns)
    rls_gain = np.zeros(ns)
    new = np.zeros(n)
    for t in range(len(y)):
        usable = use[t] and abs(y[t]) < LARGEST
        for c in range(1, channels - 1):
            if not abs(X[t, c - 1]) < LARGEST:
                usable = False
        if not usable and use[t]:
            status[t] = HELD
            predicted[t] = np.nan
            posterior[t] = np.nan
            leverage[t] = np.nan
            if len(history):
                history[t] = theta
            continue
        for c in range(1, channels - 1):
            _push(raw, filtered, c, X[t, c - 1], theta[ns:])
        q = 0
        for c in range(channels):
            sign = -1.0 if c == 0 else 1.0
            for i in range(orders[c]):
                h[q] = sign * raw[c, i]
                hf[q] = sign * filtered[c, i]
                q += 1
        guess = 0.0
        for i in range(n):
            guess += h[i] * theta[i]
        rls_guess = 0.0
        for i in range(ns):
            rls_guess += h[i] * rls_theta[i]
        predicted[t] = guess

        if not usable:
            status[t] = REJECTED
            posterior[t] = np.nan
            leverage[t] = np.nan
            _push(raw, filtered, 0, y[t] if abs(y[t]) < LARGEST else guess, theta[ns:])
            _push(raw, filtered, channels - 1, 0.0, theta[ns:])
            if len(history):
                history[t] = theta
            continue

        error = y[t] - guess  # the a-priori innovation
        rls_error = y[t] - rls_guess

        # The noise model waits until its own scale, the noise variance, is known.
        if monitor[SINCE] < settled:
            for i in range(ns, n):
                hf[i] = 0.0
        elif D[n - 1] == 0.0 and nd > 0 and monitor[RSS] > 0.0:
            variance = min(NOISE_PRIOR * monitor[WEIGHT] / monitor[RSS], 1e20)
            for i in range(ns, n):
                D[i] = variance
                ceiling[i] = 10.0 * variance

        used_lam = monitor[LAM]
        before = 0.0
        for i in range(n):
            before += ceiling[i] * hf[i] * hf[i]
        alpha = _measure(U, D, hf, used_lam, gain, f)
        leverage[t] = (alpha - used_lam) / before if before > 0.0 else 0.0
        held, share = _forget(U, D, used_lam, ceiling, ns)

        # eq. (29) with the step halved until D(q) is stable: Ljung and Söderström 1983.
        step = error / alpha
        stable = False
        for _ in range(HALVINGS):
            for i in range(n):
                new[i] = theta[i] + gain[i] * step
            stable = is_stable(new[ns:], radius)
            if stable:
                break
            step *= 0.5
        if stable:
            theta[:] = new

        rls_alpha = _measure(rls_U, rls_D, h[:ns], used_lam, rls_gain, rls_f)
        _forget(rls_U, rls_D, used_lam, ceiling[:ns], ns)
        for i in range(ns):
            rls_theta[i] += rls_gain[i] * rls_error / rls_alpha

        after = y[t]
        largest = abs(alpha)
        for i in range(n):
            after -= h[i] * theta[i]
            largest = max(largest, abs(theta[i]))
        for i in range(ns):
            largest = max(largest, abs(rls_theta[i]))
        posterior[t] = after
        _push(raw, filtered, 0, y[t], theta[ns:])
        _push(raw, filtered, channels - 1, after, theta[ns:])
        largest = max(largest, abs(filtered[channels - 1, 0]))

        monitor[COUNT] += 1.0
        monitor[SINCE] += 1.0
        if not held:
            monitor[WEIGHT] *= used_lam
            monitor[WEIGHT_SQUARED] *= used_lam * used_lam
            monitor[RSS] *= used_lam
        monitor[WEIGHT] += 1.0
        monitor[WEIGHT_SQUARED] += 1.0
        monitor[RSS] += error * error * used_lam / alpha
        monitor[LAM] = RAMP_RATE * used_lam + (1.0 - RAMP_RATE) * lam
        monitor[POWER] += 0.01 * (error * error - monitor[POWER])
        monitor[RLS_POWER] += 0.01 * (rls_error * rls_error - monitor[RLS_POWER])
        monitor[OUTPUT_POWER] += 0.01 * (y[t] * y[t] - monitor[OUTPUT_POWER])

        status[t] = OK
        if share <= UNDETERMINED and monitor[SINCE] > settled:
            monitor[DETERMINED] = 1.0
        elif monitor[DETERMINED] == 0.0:
            status[t] = WARMING_UP
        else:
            status[t] = UNEXCITED

        sane = largest < LARGEST_RESULT
        worse = monitor[POWER] > 1.5 * monitor[RLS_POWER] + ROUNDING * monitor[OUTPUT_POWER]
        if not sane or (nd > 0 and worse and monitor[SINCE] > PATIENCE):
            # Start again: from plain RLS, or from nothing where that too is out of range.
            if not sane:
                status[t] = HELD
                rls_theta[:] = 0.0
                rls_U[:] = np.eye(ns)
                rls_D[:] = ceiling[:ns]
                monitor[DETERMINED] = 0.0
                raw[:] = 0.0
            theta[:] = 0.0
            theta[:ns] = rls_theta
            U[:] = np.eye(n)
            U[:ns, :ns] = rls_U
            D[:] = 0.0
            D[:ns] = rls_D
            ceiling[ns:] = 0.0
            raw[channels - 1] = 0.0
            filtered[:] = raw
            monitor[WEIGHT] = 0.0
            monitor[WEIGHT_SQUARED] = 0.0
            monitor[RSS] = 0.0
            monitor[POWER] = 0.0
            monitor[RLS_POWER] = 0.0
            monitor[OUTPUT_POWER] = 0.0
            monitor[SINCE] = 0.0
            monitor[LAM] = min(RAMP_START, lam) if nd > 0 else lam
            monitor[RESTARTS] += 1.0
        if len(history):
            history[t] = theta


@njit(cache=True)
def evaluate(
    X: Floats,
    theta: Floats,
    U: Floats,
    D: Floats,
    ceiling: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Mean, variance (over the noise variance) and share of the prior variance at N points."""
    N, ns = X.shape
    mean = np.zeros(N)
    variance = np.zeros(N)
    share = np.zeros(N)
    for t in range(N):
        prior = 0.0
        for i in range(ns):
            mean[t] += X[t, i] * theta[i]
            prior += ceiling[i] * X[t, i] * X[t, i]
        for j in range(len(D)):
            s = X[t, j] if j < ns else 0.0
            for i in range(min(j, ns)):
                s += X[t, i] * U[i, j]
            variance[t] += D[j] * s * s
        if prior > 0.0:
            share[t] = variance[t] / prior
    return mean, variance, share
