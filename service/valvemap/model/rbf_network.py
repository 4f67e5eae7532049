"""The paper's radial basis function network, trained by gradient descent, eqs. (30)-(38)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.fleet import alone, update_one
from valvemap.model.kernels import rbf_network as kernel
from valvemap.model.map_forms import Gaussians, MapForm
from valvemap.model.samples import Codes, Floats, Samples, Segments, Trace
from valvemap.vocabulary.statuses import Adaptation, Quality, Status


@dataclass(frozen=True)
class RbfNetworkState(State):
    """Weights, centres and log-widths of m neurons in normalised units, and their last steps.

    Attributes
    ----------
    w, dw, log_b, dlog_b : (m,)
        Weights and log-widths, and their last changes (for the momentum).
    c, dc : (m, 2)
        Centres and their last changes.
    monitor : (2,)
        Count of samples, mean square of the residual.
    noted : (m, 4)
        Weight, centre and 1/width² of each neuron up to 31 samples ago.
    """

    w: Floats
    c: Floats
    log_b: Floats
    dw: Floats
    dc: Floats
    dlog_b: Floats
    monitor: Floats
    noted: Floats

    def contents(self) -> Mapping[str, Contents]:
        """Valid values of the arrays."""
        bound, outside = kernel.WEIGHT_BOUND, kernel.CENTRE_BOUND
        return {
            "w": Contents(self.w).within(-bound, bound),
            "c": Contents(self.c).within(-outside, 1.0 + outside),
            "log_b": Contents(self.log_b).within(*kernel.LOG_WIDTH_BOUNDS),
            "monitor": Contents(self.monitor).within(0.0),
            "noted": Contents(self.noted).within(0.0, where=(slice(None), 3)),
        }


@dataclass(frozen=True)
class NetworkMap:
    """A network's map as a value, see `RbfNetwork` and `RbfNetworkState`."""

    grid: tuple[int, int]
    U_range: tuple[float, float]
    dp_range: tuple[float, float]
    Q_scale: float
    w: Floats
    c: Floats
    log_b: Floats
    monitor: Floats

    def state(self) -> RbfNetworkState:
        """Return a state with this map and without momentum."""
        still = np.zeros_like(self.w), np.zeros_like(self.c), np.zeros_like(self.log_b)
        noted = np.column_stack((self.w, self.c, np.exp(-2.0 * self.log_b)))
        return RbfNetworkState(self.w, self.c, self.log_b, *still, self.monitor, noted)


@dataclass(frozen=True)
class RbfNetwork:
    """A network of Gaussian neurons over (U, dp), all its parameters trained sample by sample.

    With x = (U, dp) normalised to [0, 1]², e = Q_P - Q_M and H_j = exp(-‖x - c_j‖²/(2·b_j²)),

        Q_M = Σ w_j·H_j,   Δw_j = η·e·H_j,   Δlog b_j = η·e·w_j·H_j·‖x - c_j‖²/b_j²,
        Δc_ji = η·e·w_j·H_j·(x_i - c_ji)/b_j²,

    each with the momentum α·(last change). Unlike the published (37), H_j is included and η is
    applied once: without H_j, the step of a neuron grows with its distance from the sample, and
    scattered data make it diverge. η is divided by 1 + η·‖gradient‖²/(1 - α), so that no setting
    can overshoot; centres stay within one range of the ranges, widths within 0.02 to 3 ranges.

    The network suffers from catastrophic forgetting: after one sorted pass of structured data only
    the last level fits. :class:`~valvemap.model.radial_basis.RadialBasis` with fixed centres
    and weights by RLS does not.

    Attributes
    ----------
    grid : (int, int)
        Neurons along U and dp; their centres start on a grid.
    eta, alpha : float
        Learning rate in (0, 1], momentum factor in [0, 1).
    U_range, dp_range : (float, float)
        Ranges of U (%) and dp (bar), normalised to [0, 1].
    Q_scale : float
        Flow normalised to 1, l/min.

    References
    ----------
    The paper's section 3.5. Haykin: Neural Networks and Learning Machines, 2009.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> U, dp = rng.uniform(0, 100, 20_000), rng.uniform(0, 200, 20_000)
    >>> samples = Samples.of(t=0 * U, U=U, p1=dp, p2=0 * dp, Q=0.1 * U * np.sqrt(dp))
    >>> network = RbfNetwork()
    >>> state, trace = network.update(network.initial_state(), samples)
    >>> bool(np.sqrt(np.mean(trace.residual[-1000:] ** 2)) < 4.0)
    True
    """

    grid: tuple[int, int] = (5, 5)
    eta: float = 0.3
    alpha: float = 0.1
    U_range: tuple[float, float] = (0.0, 100.0)
    dp_range: tuple[float, float] = (0.0, 200.0)
    Q_scale: float = 200.0

    std_of_residuals: ClassVar[Literal[True]] = True

    def __post_init__(self) -> None:
        """Validate the hyper-parameters."""
        if not (2 <= self.grid[0] <= 100 and 2 <= self.grid[1] <= 100):
            raise ValueError(f"grid is {self.grid}; 2 to 100 neurons along each input are allowed")
        if not 0 < self.eta <= 1:
            raise ValueError(f"eta is {self.eta}; 0 < eta <= 1 is allowed")
        if not 0 <= self.alpha < 1:
            raise ValueError(f"alpha is {self.alpha}; 0 <= alpha < 1 is allowed")
        for name, (low, high) in (("U_range", self.U_range), ("dp_range", self.dp_range)):
            if not (np.isfinite([low, high]).all() and low < high):
                raise ValueError(f"{name} is {(low, high)}; two ascending numbers are allowed")
        if not 0 < self.Q_scale < np.inf:
            raise ValueError(f"Q_scale is {self.Q_scale}; a positive number is allowed")

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Weights w1 …, centres c1_U, c1_dp …, widths b1 …."""
        m = range(1, self.grid[0] * self.grid[1] + 1)
        return (
            *(f"w{j}" for j in m),
            *(f"c{j}_{axis}" for j in m for axis in ("U", "dp")),
            *(f"b{j}" for j in m),
        )

    def initial_state(self) -> RbfNetworkState:
        """Return zero weights, centres on the grid, widths of one mesh."""
        nU, ndp = self.grid
        gU, gdp = np.meshgrid(np.linspace(0, 1, nU), np.linspace(0, 1, ndp), indexing="ij")
        m = nU * ndp
        mesh = float(np.sqrt(1.0 / ((nU - 1) * (ndp - 1))))
        return RbfNetworkState(
            w=np.zeros(m),
            c=np.stack([gU.ravel(), gdp.ravel()], axis=1),
            log_b=np.full(m, np.log(mesh)),
            dw=np.zeros(m),
            dc=np.zeros((m, 2)),
            dlog_b=np.zeros(m),
            monitor=np.zeros(kernel.MONITORS),
            noted=np.zeros((m, 4)),
        )

    def update(self, state: RbfNetworkState, samples: Samples) -> tuple[RbfNetworkState, Trace]:
        """Update with N samples; bad and non-finite ones do not change the state."""
        return update_one(self, state, samples)

    def update_many(self, states: RbfNetworkState, samples: Samples, segments: Segments) -> Trace:
        """Update many models with their samples; their states are written in place."""
        x, finite = self._normalised(samples.U, samples.dp)
        good = (samples.quality != Quality.BAD) & np.isfinite(samples.Q) & finite
        count = len(samples)
        predicted = np.full(count, np.nan)
        status = np.full(count, Status.REJECTED, np.uint8)
        guess, behind = np.empty((2, int(good.sum())))
        outcome = np.empty(len(guess), np.uint8)
        kernel.update(
            samples.Q[good] / self.Q_scale,
            x[good],
            float(self.eta),
            float(self.alpha),
            states.w,
            states.c,
            states.log_b,
            states.dw,
            states.dc,
            states.dlog_b,
            states.monitor,
            states.noted,
            guess,
            behind,
            outcome,
            segments.among(good),
        )
        predicted[good] = guess * self.Q_scale
        status[good] = outcome
        residual, early = np.full((2, count), np.nan)
        residual[good] = samples.Q[good] - predicted[good]
        early[good] = behind * self.Q_scale
        return Trace(predicted, residual, early, status)

    def predict(
        self,
        state: RbfNetworkState,
        U: Floats,
        dp: Floats,
        T: Floats,  # noqa: ARG002 - the network does not know the temperature
    ) -> tuple[Floats, Floats]:
        """Flow and the running RMS of the residual, l/min; NaN before the first sample."""
        x, finite = self._normalised(np.asarray(U, np.float64), np.asarray(dp, np.float64))
        known = finite & (state.monitor[kernel.COUNT] > 0)
        mean = kernel.evaluate(np.where(known[:, None], x, 0.0), state.w, state.c, state.log_b)
        rms = np.sqrt(state.monitor[kernel.POWER])
        return (
            np.where(known, mean * self.Q_scale, np.nan),
            np.where(known, rms * self.Q_scale, np.nan),
        )

    def form(self, state: RbfNetworkState, T: float) -> MapForm | None:
        """Return the form of the map: analytic everywhere."""
        if not state.monitor[kernel.COUNT] > 0:
            return None
        (low_U, high_U), (low, high) = self.U_range, self.dp_range
        width, (c_U, c_dp) = np.exp(state.log_b), state.c.T
        gaussians = Gaussians(
            w=state.w * self.Q_scale,
            U=low_U + c_U * (high_U - low_U),
            a=width * (high_U - low_U),
            s=low + c_dp * (high - low),
            b=width * (high - low),
            power=2,
        )

        def flow(U: Floats, s: Floats) -> Floats:
            return self.predict(state, U, s**2, np.full(U.size, T))[0]

        return MapForm(np.empty(0), np.empty(0), (flow,), gaussians.remainder)

    def parameters(self, state: RbfNetworkState) -> tuple[Floats, Floats]:
        """Weights in l/min, centres in % and bar, widths in ranges; no standard deviations."""
        theta, std = self.parameters_many(alone(state))
        return theta[0], std[0]

    def parameters_many(self, states: RbfNetworkState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations of M ≥ 1 models, both (M, n)."""
        low = np.array([self.U_range[0], self.dp_range[0]])
        high = np.array([self.U_range[1], self.dp_range[1]])
        parts = [states.w * self.Q_scale, low + states.c * (high - low), np.exp(states.log_b)]
        theta = np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
        return theta, np.full(theta.shape, np.nan)

    def to_map(self, state: RbfNetworkState) -> NetworkMap:
        """Return the network without its momentum."""
        ranges = self.grid, self.U_range, self.dp_range, self.Q_scale
        return NetworkMap(*ranges, state.w, state.c, state.log_b, state.monitor)

    def adaptation(self, _state: RbfNetworkState) -> Adaptation:
        """Return undecided: the network does not assess its residuals."""
        return Adaptation.UNDECIDED

    def adaptation_many(self, states: RbfNetworkState) -> Codes:
        """`adaptation` of M models (M,)."""
        return np.full(len(states.w), Adaptation.UNDECIDED, np.uint8)

    def _normalised(self, U: Floats, dp: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return rows (U, dp) in ranges, and a mask of the finite ones."""
        with np.errstate(all="ignore"):
            x = np.stack(
                [
                    (U - self.U_range[0]) / (self.U_range[1] - self.U_range[0]),
                    (dp - self.dp_range[0]) / (self.dp_range[1] - self.dp_range[0]),
                ],
                axis=1,
            )
        return x, np.asarray(np.isfinite(x).all(axis=1))
