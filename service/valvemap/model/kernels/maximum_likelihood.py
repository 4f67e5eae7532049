"""Recursion of maximum likelihood, eq. (29): one step per sample, in fixed order.

Plain RLS runs in parallel on the same regressors without the noise columns, from P = ∞. If RML
predicts worse for long, it restarts from the RLS estimate.
"""

import numpy as np

from valvemap.model.kernels import filtered_scores, reaction
from valvemap.model.kernels.compiled import kernel, lean_kernel, spliced
from valvemap.model.kernels.factors import project, rank_one, write_covariance
from valvemap.model.kernels.likelihood_covariance import draw_noise_in, forget, let_noise_in
from valvemap.model.kernels.likelihood_memory import (
    COUNT,
    DETERMINED,
    FADING,
    HALVINGS,
    LARGEST,
    LOUDER,
    NOISE_PRIOR,
    OUTPUT_POWER,
    POWER,
    RAMP,
    RAMP_RATE,
    RLS_POWER,
    SINCE,
    UNDETERMINED,
    VARIANCE,
    WEIGHT,
    Memory,
    Orders,
    Rule,
    Scratch,
    dot,
    rows_of,
    scratch_of,
)
from valvemap.model.kernels.likelihood_recovery import recover
from valvemap.model.kernels.likelihood_rows import fill_regressors, look_back, push, residual_of
from valvemap.model.kernels.likelihood_spread import (
    largest_share,
    may_grow,
    spread_along,
    update_spread,
)
from valvemap.model.kernels.stability import lies_inside
from valvemap.model.samples import Codes, Floats, Segments
from valvemap.vocabulary.statuses import Status

_OK = int(Status.OK)
_WARMING_UP = int(Status.WARMING_UP)
_UNEXCITED = int(Status.UNEXCITED)
_REJECTED = int(Status.REJECTED)
_HELD = int(Status.HELD)


@lean_kernel
def run(
    fleet: Memory,
    rule: Rule,
    orders: Orders,
    X: Floats,
    U: Floats,
    y: Floats,
    use: Codes,
    predicted: Floats,
    posterior: Floats,
    early: Floats,
    share: Floats,
    status: Codes,
    history: Floats,
    segments: Segments,
    scratch: Floats,
) -> None:
    """Update many models, each with its segment of the samples.

    Parameters
    ----------
    fleet
        The states' arrays, each with a leading axis M; written in place.
    rule
        Settings of all of them.
    orders : (channels,)
        Lags of the output, of each input, of the noise.
    X : (N, inputs)
        Row t holds the inputs *before* y(t): u(t-1) of an ARMAX model, X(t) of a static map.
    U : (N,)
        Opening, %; it may react to the noise.
    y, use : (N,)
        Output; where ``use`` is 0, theta is held and a missing y is replaced by its prediction.
    predicted, posterior, early, share, status : (N,)
        Written: hᵀ·theta before, y - hᵀ·theta after the update, y minus the map (hᵀ·theta without
        the noise) of some samples before, variance of the prediction over
        that before any sample, status.
    history : (N, n) or (0, n)
        Written if it has rows: theta after each sample.
    segments
        Assignment of samples to models.
    scratch : (6, n)
        Overwritten.
    """
    (
        theta, factor, spread, prior, rls_theta, rls_factor, raw, filtered, monitor, before,
        omega, moments, blocks, colour,
    ) = fleet  # fmt: skip
    members, starts, stops = segments
    vectors = rows_of(scratch)
    for s in range(len(members)):
        m = members[s]
        memory = Memory(
            theta[m], factor[m], spread[m], prior[m], rls_theta[m], rls_factor[m], raw[m],
            filtered[m], monitor[m], before[m], omega[m], moments[m], blocks[m], colour[m],
        )  # fmt: skip
        _span(
            memory, rule, orders, vectors, X, U, y, use, predicted, posterior, early, share,
            status, history, starts[s], stops[s],
        )  # fmt: skip


@kernel
def learn(memory: Memory, rows: Floats, values: Floats) -> None:
    """Add a structure's prior as pseudo-samples row·theta = value."""
    n, ns = len(memory.theta), rows.shape[1]
    scratch = scratch_of(n)
    f, Px = scratch.f, scratch.Ph
    for t in range(len(rows)):
        for j in range(ns):
            scratch.h[j] = rows[t, j]
        r = project(memory.factor, scratch.h, f, Px)
        step = (values[t] - dot(rows[t], memory.theta, ns)) / (1.0 + r)
        for j in range(n):
            memory.theta[j] += step * Px[j]
        rank_one(memory.factor, f, scratch.work, 1.0, 1.0, 1.0)
        r = project(memory.rls_factor, rows[t], f, Px)
        step = (values[t] - dot(rows[t], memory.rls_theta, ns)) / (1.0 + r)
        for j in range(ns):
            memory.rls_theta[j] += step * Px[j]
        rank_one(memory.rls_factor, f[:ns], scratch.work, 1.0, 1.0, 1.0)


@spliced
def _span(
    memory: Memory,
    rule: Rule,
    orders: Orders,
    scratch: Scratch,
    X: Floats,
    U: Floats,
    y: Floats,
    use: Codes,
    predicted: Floats,
    posterior: Floats,
    early: Floats,
    share: Floats,
    status: Codes,
    history: Floats,
    start: int,
    stop: int,
) -> None:
    """Samples start … stop - 1 of one model."""
    n, last = len(memory.theta), len(orders) - 1
    d = memory.theta[n - orders[last] :]
    for t in range(start, stop):
        in_range = True
        for c in range(1, last):
            in_range = in_range and abs(X[t, c - 1]) < LARGEST
        y_in_range = abs(y[t]) < LARGEST
        predicted[t] = np.nan
        posterior[t] = np.nan
        early[t] = np.nan
        share[t] = np.nan
        if use[t] and not (in_range and y_in_range):
            status[t] = _HELD
        else:
            for c in range(1, last):
                push(memory, d, c, X[t, c - 1])
            fill_regressors(memory, orders, scratch)
            predicted[t] = dot(scratch.h, memory.theta, n)
            if use[t]:
                early[t] = look_back(memory, scratch.h, y[t], y[t] - predicted[t])
                of_map = dot(scratch.h, memory.theta, n - orders[last])
                reaction.weigh_in(memory.colour, filtered_scores.REACTING, U[t], y[t] - of_map)
                status[t] = _step(memory, rule, scratch, y[t], d, share, t)
                posterior[t] = residual_of(scratch.h, memory.theta, n, y[t])
                push(memory, d, 0, y[t])
                push(memory, d, last, posterior[t])
                recover(memory, posterior[t], status, t)
            else:
                status[t] = _REJECTED
                push(memory, d, 0, y[t] if y_in_range else predicted[t])
                push(memory, d, last, 0.0)
        if t < len(history):
            for j in range(n):
                history[t, j] = memory.theta[j]


@spliced
def _step(
    memory: Memory,
    rule: Rule,
    scratch: Scratch,
    y: float,
    d: Floats,
    share: Floats,
    t: int,
) -> int:
    """Process one sample by eq. (29) and by plain RLS."""
    theta, monitor = memory.theta, memory.monitor
    h, hf, f, Ph, new = scratch.h, scratch.hf, scratch.f, scratch.Ph, scratch.work
    n, nd = len(theta), len(d)
    ns = n - nd
    settled = 2 * n + 10
    if nd > 0 and monitor[SINCE] < settled:
        for j in range(ns, n):
            hf[j] = 0.0
    elif nd > 0 and memory.prior[ns] == 0.0 and monitor[VARIANCE] > 0.0:
        let_noise_in(memory, ns)

    before = 0.0
    for j in range(n):
        before += memory.prior[j] * hf[j] * hf[j]
    r = project(memory.factor, hf, f, Ph)
    share[t] = r / before if before > 0.0 else 0.0
    e = residual_of(h, theta, n, y)  # the a-priori innovation
    if nd > 0 and memory.prior[ns] > 0.0:
        variance = monitor[VARIANCE]
        variance += (e * e / (1.0 + r) - variance) / (monitor[WEIGHT] + 1.0)
        if memory.prior[ns] * variance > LOUDER * 10.0 * NOISE_PRIOR:
            draw_noise_in(memory, scratch, ns, NOISE_PRIOR / variance)
            r = project(memory.factor, hf, f, Ph)

    ramp, lam = monitor[RAMP], rule.lam
    holds = not may_grow(memory.factor, memory.prior, ramp * lam)
    if holds:
        ramp, lam = 1.0, 1.0

    # A step that makes D(q) unstable is halved: Ljung and Söderström 1983.
    step = e / (ramp * lam + r)
    for _ in range(HALVINGS):
        for j in range(n):
            new[j] = theta[j] + step * Ph[j]
        if lies_inside(new[ns:], rule.radius, scratch.Sh):
            for j in range(n):
                theta[j] = new[j]
            break
        step *= 0.5

    gain = 1.0 / (ramp * lam + r)
    q = r / ramp
    if monitor[DETERMINED] > 0.0:
        q = spread_along(memory.spread, hf, scratch.Sh)
        if not q <= 1.01 * r:  # exceeds P by rounding only
            write_covariance(memory.factor, memory.spread)
            q = spread_along(memory.spread, hf, scratch.Sh)
        update_spread(memory.spread, Ph, scratch.Sh, gain, q)
    monitor[WEIGHT] = ramp * lam * monitor[WEIGHT] + 1.0
    monitor[VARIANCE] += (e * e / (1.0 + q) - monitor[VARIANCE]) / monitor[WEIGHT]
    forget(memory.factor, rule.kind, lam, ramp, scratch, r, before)

    if monitor[DETERMINED] > 0.0:
        filtered_scores.gather(memory.omega, memory.moments, memory.blocks, memory.colour, hf, e, y)

    rls_e = residual_of(h, memory.rls_theta, ns, y)
    before = 0.0
    for j in range(ns):
        before += memory.prior[j] * h[j] * h[j]
    r = project(memory.rls_factor, h[:ns], f, Ph)
    # While plain RLS is not determined, neither is evaluated.
    trust = 1.0 / (1.0 + r)
    monitor[POWER] += FADING * (trust * e * e - monitor[POWER])
    monitor[RLS_POWER] += FADING * (trust * rls_e * rls_e - monitor[RLS_POWER])
    monitor[OUTPUT_POWER] += FADING * (trust * y * y - monitor[OUTPUT_POWER])
    lam = rule.lam if may_grow(memory.rls_factor, memory.prior, rule.lam) else 1.0
    for j in range(ns):
        memory.rls_theta[j] += rls_e / (lam + r) * Ph[j]
    forget(memory.rls_factor, rule.kind, lam, 1.0, scratch, r, before)

    monitor[RAMP] = RAMP_RATE * monitor[RAMP] + (1.0 - RAMP_RATE)
    monitor[COUNT] += 1.0
    monitor[SINCE] += 1.0
    known = monitor[DETERMINED] > 0.0
    if not known or rule.lam < 1.0:  # with lam = 1 no information is lost
        known = monitor[SINCE] > settled and largest_share(memory, ns) <= UNDETERMINED
    if known and monitor[DETERMINED] == 0.0:
        write_covariance(memory.factor, memory.spread)
        monitor[DETERMINED] = 1.0
    if monitor[DETERMINED] == 0.0:
        return _WARMING_UP
    return _OK if known and not (holds and rule.lam < 1.0) else _UNEXCITED
