"""The paper's recursions as printed, including misprints; the service does not use them."""

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np

from paper.data import Points
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.samples import Floats, Samples

P0: Final = 100.0


def least_squares(X: Floats, y: Floats, lam: float, p0: float = 1e8) -> Floats:
    """Return theta (N, n) after each sample: (27) inserted into (28), which applies λ twice.

    >>> least_squares(np.ones((50, 1)), np.arange(50.0), 0.9)[-1].round(2)
    array([44.74])
    """
    n = X.shape[1]
    theta, P, history = np.zeros(n), p0 * np.eye(n), np.empty(X.shape)
    for t, (x, q) in enumerate(zip(X, y, strict=True)):
        P_lam = P / lam  # (27)
        L = P_lam @ x / (lam + x @ P_lam @ x)  # (28)
        theta = theta + L * (q - x @ theta)
        P = (P_lam - np.outer(L, x @ P_lam)) / lam
        P = (P + P.T) / 2.0
        history[t] = theta
    return history


def maximum_likelihood_map(X: Floats, z: Floats) -> Floats:
    """Return the static map (N, n) of (29) with one lag each of z, u and ε.

    h = [-z(t-1), Xᵀ(t), ε(t-1)]; at rest z(t) = z(t-1), so the map is b/(1 + a). The input has no
    delay: the map is static.
    """
    N, n = X.shape
    scale = np.sqrt(np.mean(X**2, axis=0))
    u = X / scale
    theta, P, history = np.zeros(n + 2), P0 * np.eye(n + 2), np.empty((N, n))
    h, h_f = np.zeros(n + 2), np.zeros(n + 2)
    with np.errstate(all="ignore"):
        for t in range(N):
            h[1 : n + 1] = u[t]
            h_f[1 : n + 1] = u[t] - theta[-1] * h_f[1 : n + 1]
            g = P @ h_f
            L = g / (1.0 + h_f @ g)
            innovation = z[t] - h @ theta
            theta = theta + L * innovation
            P = P - np.outer(L, g)
            h_f[0] = -z[t] - theta[-1] * h_f[0]
            h_f[-1] = innovation - theta[-1] * h_f[-1]
            h[0], h[-1] = -z[t], innovation
            history[t] = theta[1 : n + 1] / (1.0 + theta[0]) / scale
    return history


class Network(NamedTuple):
    """Weights (m,), centres (m, d) and widths (m,), and their last changes."""

    w: Floats
    c: Floats
    b: Floats
    dw: Floats
    dc: Floats
    db: Floats


Step = Callable[[Network, Floats, float, RbfNetwork], Network]


def corrected_step(net: Network, x: Floats, y: float, settings: RbfNetwork) -> Network:
    """Process one sample by (30)-(38) with H_j in (37), without limits of steps or parameters."""
    H, square, e = _activity(net, x, y)
    return _moved(net, x, settings, e, H, square, H)


def step_of_37(net: Network, x: Floats, y: float, settings: RbfNetwork) -> Network:
    """Process one sample with (37) as printed: without H_j."""
    H, square, e = _activity(net, x, y)
    return _moved(net, x, settings, e, H, square, np.ones_like(H))


def step_of_32(net: Network, x: Floats, y: float, settings: RbfNetwork) -> Network:
    """Process one sample with the gradient of (32) as printed: without the square, e is missing."""
    H, square, _ = _activity(net, x, y)
    return _moved(net, x, settings, 0.5, H, square, H)


def start(settings: RbfNetwork) -> Network:
    """Return the service's initial network: zero weights, centres on a grid, widths of one mesh."""
    state = settings.initial_state()
    return network(state.c, float(np.exp(state.log_b[0])))


def network(centres: Floats, width: float) -> Network:
    """Return an untrained network."""
    m = len(centres)
    zero = np.zeros(m)
    return Network(zero, centres, np.full(m, width), zero, np.zeros_like(centres), zero)


def course(
    net: Network, x: Floats, y: Floats, settings: RbfNetwork, step: Step
) -> Iterator[Network]:
    """Yield the network after each sample; x (N, d), y (N,) in l/min."""
    with np.errstate(all="ignore"):
        for row, value in zip(x, y / settings.Q_scale, strict=True):
            net = step(net, row, float(value), settings)
            yield net


def output(net: Network, x: Floats) -> Floats:
    """Return Q_M (N,), relative to the network's scale of Q, at x (N, d); eqs. (30), (31)."""
    with np.errstate(all="ignore"):
        square = sum((x[:, i, None] - net.c[:, i]) ** 2 for i in range(x.shape[1]))
        return np.asarray(np.exp(-square / (2.0 * net.b**2)) @ net.w)


def normalised(points: Samples | Points, settings: RbfNetwork) -> Floats:
    """Return rows (U, dp), scaled to the network's ranges, (N, 2)."""
    (U0, U1), (dp0, dp1) = settings.U_range, settings.dp_range
    return np.stack([(points.U - U0) / (U1 - U0), (points.dp - dp0) / (dp1 - dp0)], axis=1)


def _activity(net: Network, x: Floats, y: float) -> tuple[Floats, Floats, float]:
    """Return H_j, ‖x - c_j‖² and the error Q_P - Q_M."""
    square = np.sum((x - net.c) ** 2, axis=1)
    H = np.exp(-square / (2.0 * net.b**2))  # (30)
    return H, square, float(y - net.w @ H)  # (31)


def _moved(
    net: Network, x: Floats, settings: RbfNetwork, e: float, H: Floats, square: Floats, H_37: Floats
) -> Network:
    w, c, b = net.w, net.c, net.b
    eta, alpha = settings.eta, settings.alpha
    dw = eta * e * H + alpha * net.dw  # (33), (34)
    db = eta * e * w * H * square / b**3 + alpha * net.db  # (35), (36)
    dc = eta * e * (w * H_37 / b**2)[:, None] * (x - c) + alpha * net.dc  # (37), (38)
    return Network(w + dw, c + dc, b + db, dw, dc, db)
