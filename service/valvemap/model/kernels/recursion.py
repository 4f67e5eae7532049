"""The recursion over samples: one call per batch, no allocation per sample.

Each model starts in the information form, until theta is determined, and continues in the
covariance form. Rules with operations before or after each step are in
:mod:`valvemap.model.kernels.stepwise`.
"""

from typing import NamedTuple

import numpy as np

from valvemap.model.kernels.change_detection import STARTLING, attend, has_changed, weigh
from valvemap.model.kernels.compiled import kernel
from valvemap.model.kernels.covariance_form import (
    forget_subspace,
    grows_beyond_limit,
    hurry,
    is_nth,
    learn_noise,
    let_go,
    note,
    pace,
    variable_lam,
    weight_along,
)
from valvemap.model.kernels.information_form import warm_up
from valvemap.model.kernels.place_layout import NODES_A, PROVEN, Remembered
from valvemap.model.kernels.place_refit import refit
from valvemap.model.kernels.place_visits import LONGEST
from valvemap.model.kernels.places import (
    LOOK_EVERY,
    LOOK_EVERY_DRIFTING,
    LOOK_EVERY_YOUNG,
    REFIT,
    YOUNG,
    look,
)
from valvemap.model.kernels.prefetch import fetch
from valvemap.model.kernels.reaction import weigh_in as weigh_reaction
from valvemap.model.kernels.residual_spread import EARLIER
from valvemap.model.kernels.row_layout import (
    ATTENTIVE,
    CLOCK,
    COUNT,
    FACTORED,
    FADING,
    HASTE,
    LOOKS,
    PLACES_OF_COUNTERS,
    REACTION,
    SAMPLE,
    SIZE,
    SQUARES,
    TRACE,
    VARIANCE,
    WEIGHT,
    Counts,
    Size,
    places_of,
)
from valvemap.model.kernels.rules import (
    DIRECTIONAL,
    LARGEST,
    RESETTING,
    SUBSPACE,
    TRACE_LIMIT,
    VARIABLE,
    Rule,
    rejection,
)
from valvemap.model.kernels.scores import SETTLED, gather, gather_moments
from valvemap.model.kernels.triangles import add_square, rotate, take_in, whiten
from valvemap.model.samples import Codes, Floats, Segments, Singles, Times
from valvemap.vocabulary.statuses import Status

TRACE_EVERY = 16
STEP_U = 100.0 / (NODES_A - 1)  # %: U per step of the grid of places
NOISE_LAM = 0.9995  # of the mean square of the noise, for rules with change detection

_OK = int(Status.OK)
_UNEXCITED = int(Status.UNEXCITED)
_HELD = int(Status.HELD)


class Memory(NamedTuple):
    """The arrays of many states, see :class:`~valvemap.model.least_squares_state.RlsState`.

    All with a leading axis M. The kernels write into them.
    """

    row: Floats
    R: Floats
    rhs: Floats
    counters: Counts
    window: Floats
    flows: Floats
    places: Singles
    visits: Codes


class Batch(NamedTuple):
    """N samples and output arrays.

    t, X, y, usable : (N,), (N, n), (N,), (N,)
        Samples; those with ``usable`` 0 do not change the state.
    a, b : (N,)
        Position of each sample on the grid of places, in steps; NaN: nowhere.
    nodes : (K, n) or (0, n)
        Regressors at the nodes of that grid; without rows there is none.
    predicted, residual, early, status : (N,)
        Written: the trace.
    thetas : (N, n) or (0, n)
        Written if it has rows: theta after each sample.
    changes : (C, 3)
        Written, the first C: sample of the alarm, first sample after the change, mean innovation
        from there to the alarm.
    """

    t: Times
    X: Floats
    y: Floats
    usable: Codes
    a: Floats
    b: Floats
    nodes: Floats
    predicted: Floats
    residual: Floats
    early: Floats
    status: Codes
    thetas: Floats
    changes: Floats


@kernel
def run(size: Size, memory: Memory, rule: Rule, batch: Batch, segments: Segments) -> None:
    """Update every model with its segment of the samples.

    A single flat loop: at n = 5 a call that is not inlined costs as much as a step.

    Parameters
    ----------
    size
        Of length n.
    memory, rule
        The states, written in place; one rule for all.
    batch
        The samples of all models; written too.
    segments
        Assignment of samples to models.
    """
    row, R, rhs, counters, _, flows, places, visits = memory
    t, X, y, usable, a, b, nodes, predicted, residual, early, status, thetas, changes = batch
    n = len(size)
    at = places_of(n)
    kind, found = rule.kind, 0
    divides, watches = kind <= RESETTING, rule.threshold < np.inf
    placed = watches and len(nodes) > 0
    s, own, box = np.empty(at.end), np.empty(PLACES_OF_COUNTERS, np.int64), np.empty(8)
    for one in range(len(segments.members)):
        m, first, stop = segments.members[one], segments.starts[one], segments.stops[one]
        kept = Remembered(flows[m], places[m], visits[m])
        if one + 1 < len(segments.members):
            fetch((row, counters, flows, places, visits), segments.members[one + 1])
        for p in range(at.x):
            s[p] = row[m, p]
        for p in range(PLACES_OF_COUNTERS):
            own[p] = counters[m, p]
        while first < stop and own[FACTORED] == 0:
            warm_up(
                s, R[m], rhs[m], own, kind, rule.lam,
                X, y, usable, predicted, residual, early, status, thetas, first,
            )  # fmt: skip
            first += 1
        lam = pace(size, s, at, rule)
        for j in range(n):
            s[at.unit + j] = 1.0 / s[at.scale + j] if s[at.scale + j] > 0.0 else 0.0
        for i in range(first, stop):
            # The innovation, and what P makes of X: f = Uᵀx, r = xᵀPx.
            within = abs(y[i]) <= LARGEST
            total = 0.0
            for j in range(n):
                s[at.x + j] = X[i, j]
                total += s[at.x + j] * s[at.theta + j]
                within &= abs(s[at.x + j]) <= LARGEST
            e = y[i] - total
            predicted[i] = total
            residual[i] = e
            r = whiten(size, s, at.factor, at.x, at.f)
            if not (within and usable[i] == 1 and r < LARGEST):
                code = rejection(X, y, usable, i)
                status[i] = _HELD if code == _OK else code
                residual[i] = np.nan
                early[i] = np.nan
                if not np.isfinite(total):
                    predicted[i] = np.nan
                note(s, at, thetas, i, n)
                continue
            early[i] = np.nan
            if own[COUNT] & (LOOKS - 1) == 0:  # faster than %
                if own[COUNT] & (EARLIER - 1) == 0:
                    for j in range(n):
                        s[at.early + j] = s[at.theta + j]
                total = 0.0
                for j in range(n):
                    total += s[at.x + j] * s[at.early + j]
                early[i] = e if np.isnan(total) else y[i] - total  # NaN without a copy
            own[COUNT] += 1
            for j in range(n):
                if abs(s[at.x + j]) > s[at.scale + j]:
                    s[at.scale + j] = abs(s[at.x + j])
                    s[at.unit + j] = 1.0 / s[at.scale + j]

            if placed:
                weigh_reaction(s, at.detector + REACTION, STEP_U * a[i], e)
            every = LOOK_EVERY_YOUNG
            if own[COUNT] > YOUNG:
                drifts = placed and s[at.detector + HASTE] > PROVEN
                every = LOOK_EVERY_DRIFTING if drifts else LOOK_EVERY
            if watches and e * e > STARTLING * s[at.noise + VARIANCE]:
                attend(s, at.detector)
            looks = watches and (s[at.detector + ATTENTIVE] > 0.0 or is_nth(own[COUNT], every))
            d = np.nan
            if placed and looks:
                d = look(size, s, at, nodes, kept, box, a[i], b[i], e, r, own, rule)

            # Forgetting: P ← (P - weight·PXXᵀP/(alpha + weight·r))/alpha.
            code = _OK if r > 0.0 else _UNEXCITED
            alpha, weight, held = 1.0, 1.0, False
            if divides:
                alpha = lam
                if kind == VARIABLE:
                    alpha = variable_lam(s, at, rule, e, r)
                due = own[COUNT] % TRACE_EVERY == 0 or s[at.noise + TRACE] > TRACE_LIMIT
                if due and lam < 1.0:
                    held = grows_beyond_limit(size, s, at, alpha, r)
                    if held:
                        alpha, code = 1.0, _UNEXCITED
            if lam < 1.0 and r > 0.0 and (kind == DIRECTIONAL or held):  # Kulhavý: along X only
                weight = weight_along(size, s, at, lam, r)
            elif lam < 1.0 and kind == SUBSPACE and is_nth(own[COUNT], rule.every_nth):
                forget_subspace(size, s, at, lam**rule.every_nth)
                r = whiten(size, s, at.factor, at.x, at.f)
            growth = 1.0 if alpha == 1.0 else 1.0 / alpha
            gain = take_in(size, s, at.factor, at.f, at.Px, alpha, weight, growth)

            # Covariance of theta due to noise; q: of Xᵀtheta.
            q = r
            if s[at.noise + WEIGHT] > 0.0 and not watches:
                q = r * s[at.noise + SQUARES] / s[at.noise + WEIGHT]
            if weight != 1.0:
                added = 1.0 if divides else (1.0 - weight) * lam
                rotate(size, s, at.spread, at.x, at.Px, at.g, 1.0 - weight, added)
            elif divides:
                add_square(size, s, at.spread, at.x, alpha * alpha)
            square = e * e / (1.0 + q)
            learn_noise(s, at, kind, NOISE_LAM if watches else lam, square)

            # L = P(t)·X(t), eq. (23).
            gain *= e
            for j in range(n):
                s[at.theta + j] += gain * s[at.Px + j]
            status[i] = code
            note(s, at, thetas, i, n)
            if watches:
                if r < SETTLED:
                    gather(size, s, at, e, y[i])
                if rule.lam < 1.0:
                    hurry(s, at, rule, e, square)
            if looks:
                gather_moments(size, s, at)
                weigh(size, s, at, d, e, y[i], r, own[COUNT])
                if has_changed(size, s, at, kept, own, t[i], rule, every):
                    let_go(size, s, at, own, rule.lam)
                    if found < len(changes):
                        changes[found, 0] = i
                        changes[found, 1] = i - (own[COUNT] - own[SAMPLE])
                        changes[found, 2] = s[at.detector + SIZE]
                    found += 1
                s[at.detector + FADING] = np.exp(s[at.detector + HASTE]) / LONGEST
                lam = pace(size, s, at, rule)
            drifts = placed and rule.lam == 1.0 and s[at.detector + HASTE] > PROVEN
            if drifts and own[COUNT] & (REFIT - 1) == 0:
                refit(s, R[m], rhs[m], kept, nodes, s[at.detector + CLOCK])
        for p in range(at.x):
            row[m, p] = s[p]
        for p in range(PLACES_OF_COUNTERS):
            counters[m, p] = own[p]
