"""The recursion over many models at once: one call, every model its own stretch of the samples."""

import numpy as np

from service.identification.kernels.compiled import kernel
from service.identification.kernels.recursion import Batch, Memory, Rule, span
from service.identification.samples import Segments


@kernel
def run_fleet(fleet: Memory, rule: Rule, batch: Batch, segments: Segments) -> None:
    """Every model takes its own stretch of the samples.

    Parameters
    ----------
    fleet
        The states' arrays, each with a leading axis M; written in place.
    rule, batch
        As for one model; the samples of all models one after another.
    segments
        Which samples are whose.
    """
    theta, factor, rhs, spread, scale, noise, counters, _ = fleet[:8]
    detector, history, score, variance, previous = fleet[8:]
    t, X, y, usable, predicted, residual, status, thetas, changes = batch
    evidence = np.empty((len(y) if rule.threshold < np.inf else 0, 3))
    work = np.empty((5, X.shape[1]))
    members, starts, stops = segments
    for s in range(len(members)):
        m = members[s]
        span(
            theta[m], factor[m], rhs[m], spread[m], scale[m], noise[m], counters[m], detector[m],
            history[m], score[m], variance[m], previous[m], rule.kind, rule.lam, rule.least,
            rule.threshold, t, X, y, usable, predicted, residual, status, thetas, changes,
            evidence, work, starts[s], stops[s],
        )  # fmt: skip
