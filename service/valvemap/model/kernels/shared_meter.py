"""The loop of `SharedMeter`: recursive least squares on the sum of several valves' flows.

The state's ``P`` is the covariance of the weights in units of the noise's variance. A sample
changes at most two weights of each valve, and its gain those that are known together with them.
"""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.samples import Floats

KNOTS = 81  # of a valve's gain over its range of U: every 1.25 %
LEAST_NOISE = 1e-3  # l/min
USUAL_NOISE = 0.4  # l/min; of a meter, before the first sample
USUAL_SLOPE = 0.2  # l/min/√bar/%; standard deviation of a gain's slope at U = 0
BEND_OF_EDGE = 0.02  # l/min/√bar/%/√%; the same where an overlap ends
OVERLAPPED = 20.0  # % of U; no overlap is larger
USUAL_BEND = 0.0015  # l/min/√bar/%/√%; of the slope's change
USUAL_LEAK = 0.02  # l/min/√bar; standard deviation of what a shut valve passes
USUAL_KINK = 0.0005  # l/min/√bar; standard deviation of each knot beside all that
KEPT = 20_000.0  # samples of one weight after which its variance has grown by its own size
FEW = 50.0  # samples before residuals are clipped
CLIPPED = 4.0  # standard deviations
MEMORY = 5_000.0  # samples over which the noise is averaged
TINY = 1e-12  # noise variances; least variance of the leaks' sum
LEAST_WEIGHT = 0.02  # of a sample; less says next to nothing of a valve
WHOLE = 0.999  # of a sample
BOUNDED_EVERY = 256  # samples; then the leaks are bounded by their sum
WORTH = 1.1  # times the precision; less of a bound changes nothing
# Places in `sums`: mean square of the residuals, their number, and the precision of a shut valve's
# gain before any sample, in that of the noise.
MEAN_SQUARE, COUNT, SHUT = 0, 1, 2


@inner
def _bound_leaks(weights: Floats, P: Floats, sums: Floats, shut: np.ndarray, Px: Floats) -> None:
    """Let no valve leak more than all together: ``shut`` (M,) are the weights of shut valves.

    Valves that are seldom shut alone show the sum L of their leaks long before each one, and what
    is uncertain of each remains in the flow of the others. No leak is negative, so E[l²] <= E[L²]
    = E[L]² + var(L). A precision that exceeds the prior's is added as an observation l = 0.
    """
    n = len(weights)
    total = variance = 0.0
    for a in shut:
        total += weights[a]
        for b in shut:
            variance += P[a, b]
    noise = max(sums[MEAN_SQUARE], LEAST_NOISE**2)
    precision = 1.0 / (total * total / noise + max(variance, TINY))
    if precision <= WORTH * sums[SHUT]:
        return
    uncertain = 1.0 / (precision - sums[SHUT])
    sums[SHUT] = precision
    for k in shut:
        spread = P[k, k] + uncertain
        expected = weights[k]
        for j in range(n):
            Px[j] = P[k, j]
        for j in range(n):
            weights[j] -= Px[j] / spread * expected
        for i in range(n):
            gain = Px[i] / spread
            if gain != 0.0:
                for j in range(n):
                    P[i, j] -= gain * Px[j]


@lean_kernel
def learn(
    U: Floats, dp: Floats, Q: Floats, usable: np.ndarray, low: Floats, high: Floats,
    weights: Floats, P: Floats, sums: Floats, held: Floats, most: Floats, shut: np.ndarray,
    others: Floats, std: Floats, told: np.ndarray, places: np.ndarray, x: Floats, Px: Floats,
    parts: Floats,
) -> None:  # fmt: skip
    r"""Learn from N samples of M valves, U and dp (M, N); write what is not valve m's, (M, N).

    ``others`` is the flow of all other valves as predicted from the samples before, ``std`` its
    standard deviation in that of the noise; NaN of a sample that is not usable. ``most`` (n,) is
    the largest variance of each weight, ``shut`` (M,) the place of each valve's weight at U = 0;
    ``places``, ``x`` (2 M,), ``Px`` (n,) and ``parts`` (M, 2) are scratch.

    What a sample says of valve m: let A be the variance of its flow before, C the covariance with
    that of the others, S the variance of the measured sum, all in that of the noise. The update of
    all weights moves the valve's flow as one observation of it alone would, of the residual
    r A / (A + C) and the variance A² S / (A + C)² - A. Its reciprocal is the sample's weight;
    ``held`` (M, 2) collects weights and residuals until they make a whole sample: it is ``told``.
    """
    M, n = len(U), len(weights)
    for i in range(len(Q)):
        known = usable[i] and math.isfinite(Q[i])
        for m in range(M):
            others[m, i] = std[m, i] = math.nan
            known = known and math.isfinite(U[m, i] + dp[m, i])
        if not known:
            continue
        for m in range(M):
            at = (U[m, i] - low[m]) / (high[m] - low[m]) * (KNOTS - 1)
            at = min(max(at, 0.0), KNOTS - 1.0)
            knot = min(int(at), KNOTS - 2)
            root = math.copysign(math.sqrt(abs(dp[m, i])), dp[m, i])
            places[2 * m], places[2 * m + 1] = m * KNOTS + knot, m * KNOTS + knot + 1
            x[2 * m], x[2 * m + 1] = (1.0 - at + knot) * root, (at - knot) * root
        for k in range(n):
            total = 0.0
            for a in range(2 * M):
                total += P[places[a], k] * x[a]
            Px[k] = total
        noise = max(sums[MEAN_SQUARE], LEAST_NOISE**2)
        predicted = whole = 0.0
        for m in range(M):
            own = 0.0
            for a in range(2 * m, 2 * m + 2):
                predicted += x[a] * weights[places[a]]
                own += x[a] * Px[places[a]]
            whole += own
            parts[m, 0] = own  # covariance with the sum
            alone = 0.0
            for a in range(2 * m, 2 * m + 2):
                for b in range(2 * m, 2 * m + 2):
                    alone += x[a] * P[places[a], places[b]] * x[b]
            parts[m, 1] = alone
        spread = 1.0 + whole
        residual = Q[i] - predicted
        for m in range(M):
            own = x[2 * m] * weights[places[2 * m]] + x[2 * m + 1] * weights[places[2 * m + 1]]
            others[m, i] = predicted - own
            variance = whole - 2.0 * parts[m, 0] + parts[m, 1]
            std[m, i] = math.sqrt(max(variance, 0.0))
            told[m, i] = False
            if parts[m, 0] <= 0.0 or parts[m, 1] <= 0.0:
                continue
            ratio = parts[m, 1] / parts[m, 0]
            weight = 1.0 / max(ratio * ratio * spread - parts[m, 1], 1.0)
            if weight < LEAST_WEIGHT:
                continue
            if weight < WHOLE:
                held[m, 0] += weight
                held[m, 1] += weight * ratio * residual
                if held[m, 0] < WHOLE:
                    continue
                others[m, i] = Q[i] - own - held[m, 1] / held[m, 0]
                held[m, 0] = held[m, 1] = 0.0
            else:
                others[m, i] = Q[i] - own - ratio * residual
            told[m, i] = True
        if sums[COUNT] > FEW:
            widest = CLIPPED * math.sqrt(noise * spread)
            residual = min(max(residual, -widest), widest)
        for k in range(n):
            weights[k] += Px[k] / spread * residual
        for k in range(n):
            gain = Px[k] / spread
            if gain != 0.0:
                for j in range(n):
                    P[k, j] -= gain * Px[j]
        for a in range(2 * M):
            k = places[a]
            if x[a] != 0.0:
                P[k, k] = min(max(P[k, k], 0.0) * (1.0 + 1.0 / KEPT), most[k])
        sums[COUNT] += 1.0
        share = 1.0 / min(sums[COUNT] + FEW, MEMORY)
        sums[MEAN_SQUARE] += share * (residual * residual / spread - sums[MEAN_SQUARE])
        if M > 1 and sums[COUNT] % BOUNDED_EVERY == 0.0:
            _bound_leaks(weights, P, sums, shut, Px)
