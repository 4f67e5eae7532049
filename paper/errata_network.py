"""Errata of the radial basis function network, eqs. (30)-(38)."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from paper import printed
from paper.data import PaperData
from paper.erratum import Erratum
from paper.learning import USELESS, WHY_USELESS, error_of, learnt, rmse
from paper.printed import Step
from valvemap.model.model_structures import FiveTerms
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.samples import Floats

BRISK = 0.5


def of_the_network(data: PaperData, network: RbfNetwork) -> Iterator[Erratum]:
    """Evaluate the errata of eqs. (30) to (38) on the scattered recording."""
    m = network.grid[0] * network.grid[1]
    H, w = np.ones((m, 1)), np.ones((m, 1))
    yield _regressors_as_inputs(data, network)
    yield Erratum(
        "(31)",
        "Q_M = H·wᵀ",
        "Q_M = wᵀ·H",
        f"numbers in the product beside the one that is wanted, {m} neurons",
        float((H @ w.T).size - 1),
        float((w.T @ H).size - 1),
        0.0,
        "Q_M is one number",
    )
    yield Erratum(
        "(32)",
        "ε = ½·(Q_P − Q_M)",
        "ε = ½·(Q_P − Q_M)²",
        "error of the map after one pass down the gradient of ε, l/min",
        _error(data, network, printed.step_of_32),
        _error(data, network, printed.corrected_step),
        USELESS,
        WHY_USELESS,
    )
    yield _widths(data, replace(network, eta=BRISK, alpha=BRISK))
    yield Erratum(
        "(37)",
        "Δc_ji = e·w_j·(x − c_ji)/b_j², without H_j",
        "Δc_ji = e·w_j·H_j·(x_i − c_ji)/b_j², η once, in (38)",
        "error of the map after one pass, l/min",
        _error(data, network, printed.step_of_37),
        error_of(network, learnt(network, data.scattered), data.new),
        USELESS,
        WHY_USELESS,
    )


def _regressors_as_inputs(data: PaperData, network: RbfNetwork) -> Erratum:
    """Evaluate X of (8) as input of (30): U·√dp, up to 1,400, dominates the distances."""
    structure, samples, truth = FiveTerms(), data.scattered, data.new
    grid = network.initial_state().c
    U, dp = 100.0 * grid[:, 0], 200.0 * grid[:, 1]
    centres = structure.regressors(U, dp, dp)
    gaps = np.linalg.norm(centres[:, None] - centres, axis=2)
    width = float(np.median(np.min(gaps + np.where(gaps == 0.0, np.inf, 0.0), axis=1)))
    x = structure.regressors(samples.U, samples.dp, samples.T)
    xv = structure.regressors(truth.U, truth.dp, truth.T)
    net = printed.network(centres, width)
    *_, last = printed.course(net, x, samples.Q, network, printed.corrected_step)
    return Erratum(
        "(30)",
        "X is the regressor vector of (8)",
        "X is the raw input (U, Δp), normalised",
        "error of the map after one pass, l/min",
        rmse(network.Q_scale * printed.output(last, xv), truth.Q),
        error_of(network, learnt(network, samples), truth),
        USELESS,
        WHY_USELESS,
    )


def _widths(data: PaperData, network: RbfNetwork) -> Erratum:
    """Evaluate additive changes of the widths b, which may become negative; log b may not."""
    x = printed.normalised(data.scattered, network)
    nets = printed.course(
        printed.start(network), x, data.scattered.Q, network, printed.corrected_step
    )
    passed = sum(int(np.sum(~(before.b * after.b > 0.0))) for before, after in pairwise(nets))
    b = np.exp(learnt(network, data.scattered).log_b)
    return Erratum(
        "(33)–(36)",
        "b_j ← b_j + Δb_j, steps without bound",
        "log b_j adapted, steps bounded, inputs normalised",
        f"times that a width passed 0 in one pass, η = {network.eta:g}, α = {network.alpha:g}",
        float(passed),
        float(np.sum(~(b > 0.0))),
        0.0,
        "a width is positive",
    )


def _error(data: PaperData, network: RbfNetwork, step: Step) -> float:
    x = printed.normalised(data.scattered, network)
    *_, last = printed.course(printed.start(network), x, data.scattered.Q, network, step)
    return _map_error(last, data, network)


def _map_error(net: printed.Network, data: PaperData, network: RbfNetwork) -> float:
    xv: Floats = printed.normalised(data.new, network)
    return rmse(network.Q_scale * printed.output(net, xv), data.new.Q)
