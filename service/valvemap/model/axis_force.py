"""The friction of a cylinder from the balance of forces, beside a load that is not measured.

::

    10·(A_A·p_A - A_B·p_B) = m·ẍ + load + D·s(ẋ) + b·ẋ        N, with cm² and bar

Mass m, load, dry friction D and the viscous part b are unknown. s(ẋ) is dry friction's course: its
sign is that of ẋ, so that D jumps where the piston turns or creeps, and a load does not. All terms
pass a band of 2 to 5 Hz, in which a load that changes within seconds has faded; a load that jumps
is a row far off, which counts less (Student). ẋ is the speed by the map, which also knows
slow creeping that a position sensor's noise hides. The speed of the transition of s is that of the
least residual.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

import numpy as np

from valvemap.model.axis import AxisGeometry, AxisSamples
from valvemap.model.kernels import axis_force as kernel
from valvemap.model.samples import Floats

_LOW_Hz, _HIGH_Hz, _SMOOTH_Hz = 5.0, 2.0, 20.0  # low-pass, high-passes, and of the speed in s
_TRANSITIONS_MM_S: Final = (1.0, 2.0, 4.0, 8.0, 16.0)  # tried
_SETTLING_S: Final = 1.0  # s; a step of the load has then faded
_ROW_S, _BLOCK_S = 0.04, 1.0  # s; from row to row; of blocks that tell how rows hang together
_LEAST_ROWS: Final = 1_000  # 40 s; a reference needs
_ROUNDS: Final = 4  # of weighing rows by their residuals
_DRIFT_DRY: Final = 0.1  # of D, on a healthy axis: seals, temperature, pressure
_DRIFT_MASS: Final = 1.0  # of m: what the axis carries changes
_DRIFT_VISCOUS: Final = 10.0  # D per m/s, beside b itself: loads depend on speed, too
_SIZE: Final = 1.0  # of D; prior standard deviation of a change
_NOISE_KNOWN: Final = 10.0  # ν of σ²: the load is not the same all the time
_LEAST_N: Final = 1.0  # N; of D and σ

SUMS: Final = ("M", "b", "squares", "scores")
"""Of a `ForceState`: what windows add to the reference."""


@dataclass(frozen=True)
class ForceState:
    """Filters and sums of rows; arrays as in :func:`.kernels.axis_force.force_rows`."""

    memory: Floats
    M: Floats
    b: Floats
    squares: Floats
    scores: Floats

    @classmethod
    def initial(cls) -> Self:
        """Return the state before the first sample."""
        n = kernel.COLUMNS
        memory = np.zeros(kernel.MEMORY)
        return cls(memory, np.zeros((n, n)), np.zeros(n), np.zeros(3), np.zeros(4))

    def emptied(self) -> "ForceState":
        """Return the state with its filters, and no rows."""
        return replace(ForceState.initial(), memory=self.memory)

    def joined(self, more: "ForceState", keep: float) -> "ForceState":
        """Return these sums, of which the share ``keep`` stays, with those of more rows."""
        sums = {name: keep * getattr(self, name) + getattr(more, name) for name in SUMS}
        return replace(self, **sums)


class ForceEvidence(NamedTuple):
    """Log Bayes factor of a change of D, and its size and variance relative to D."""

    factor: float
    size: float
    variance: float


@dataclass(frozen=True)
class ForceReference:
    """The balance as it was: θ (3,) = D (N), b (N·s/m), m (kg), their precision, and the rows' σ.

    ``together`` rows count as one; ``transition`` (m/s) is that of dry friction's course.
    """

    geometry: AxisGeometry
    period_s: float
    transition: float
    theta: Floats
    precision: Floats
    sigma: float
    together: float

    @classmethod
    def of(
        cls, geometry: AxisGeometry, period_s: float, samples: AxisSamples, speed: Floats
    ) -> "ForceReference | None":
        """Return the reference of samples, whose speed by the map is ``speed`` (N,), mm/s.

        None: too few rows, or no dry friction is to be seen.
        """
        found = []
        for transition in _TRANSITIONS_MM_S:
            one = replace(
                cls.nothing(), geometry=geometry, period_s=period_s, transition=1e-3 * transition
            )
            for _ in range(_ROUNDS):
                state = one.update(ForceState.initial(), samples, speed)
                if state.squares[2] < _LEAST_ROWS:
                    return None
                one = one.fitted(state)
            found.append(one)
        best = min(found, key=lambda one: one.sigma)
        return best if best.theta[0] > _LEAST_N else None

    @classmethod
    def nothing(cls) -> Self:
        """Return a reference that knows nothing."""
        n = kernel.COLUMNS
        return cls(AxisGeometry(1, 0, 1, 1, 1), 1.0, 0.0, np.zeros(n), np.eye(n), 0.0, 1.0)

    def update(self, state: ForceState, samples: AxisSamples, speed: Floats) -> ForceState:
        """Return the state after samples; any division of them gives the same bits."""
        after = ForceState(*(array.copy() for array in vars(state).values()))
        g = self.geometry
        force = 10.0 * (g.A_A * samples.pA - g.A_B * samples.pB)
        kernel.force_rows(
            force,
            1e-3 * speed,
            self._settings(),
            self.theta,
            after.memory,
            after.M,
            after.b,
            after.squares,
            after.scores,
        )
        return after

    def fitted(self, state: ForceState) -> "ForceReference":
        """Return the reference of a state's rows, which this one has weighed."""
        M, b, (yy, weight, _) = state.M, state.b, state.squares
        scores, length = state.scores, max(state.scores[2], 1e-300)
        together = float(np.clip(scores[1] / length, 1.0, 1e3)) if self.sigma else 1.0
        theta = np.asarray(np.linalg.lstsq(M, b, rcond=None)[0], np.float64)
        loss = max(float(yy - 2.0 * b @ theta + theta @ M @ theta), 0.0)
        sigma = max(math.sqrt(loss / max(weight, 1.0)), _LEAST_N)
        known = np.linalg.pinv(M / (together * sigma**2))
        dry = max(abs(theta[0]), _LEAST_N)
        drift = [
            _DRIFT_DRY * dry,
            math.hypot(theta[1], _DRIFT_VISCOUS * dry),
            _DRIFT_MASS * (abs(theta[2]) + 1.0),
        ]
        precision = np.linalg.inv(known + np.diag(np.square(drift)))
        return replace(self, theta=theta, precision=precision, sigma=sigma, together=together)

    def weighed(self, window: ForceState, mean: float, spread: float) -> ForceEvidence:
        """Weigh a window: has D changed? ``mean`` and ``spread`` are of its size before, in D."""
        scale = self.together * self.sigma**2
        A, theta = window.M / scale, self.theta
        r = (window.b - window.M @ theta) / scale
        yy, n = float(window.squares[0]), float(window.squares[1]) / self.together
        squares = (yy - 2.0 * window.b @ theta + theta @ window.M @ theta) / scale
        solved = np.linalg.solve(A + self.precision, np.column_stack([A, r]))
        K, u = A - A @ solved[:, :-1], r - A @ solved[:, -1]
        left = max(float(squares - r @ solved[:, -1]), 0.0)
        D = max(abs(float(theta[0])), _LEAST_N)
        before = 1.0 / spread
        after = before + D * D * float(K[0, 0])
        at = (D * float(u[0]) + before * mean) / after
        less = max(left - (after * at * at - before * mean * mean), 0.0)
        better = np.log1p(left / _NOISE_KNOWN) - np.log1p(less / _NOISE_KNOWN)
        factor = 0.5 * ((_NOISE_KNOWN + n) * better - np.log(after / before))
        noise = max(1.0, less / max(n, 1.0))
        return ForceEvidence(float(factor), at, noise / after)

    def _settings(self) -> Floats:
        period = self.period_s
        shares = (-math.expm1(-2.0 * math.pi * f * period) for f in (_SMOOTH_Hz, _LOW_Hz, _HIGH_Hz))
        stride = max(1.0, round(_ROW_S / period))
        settling, block = round(_SETTLING_S / period), round(_BLOCK_S / (stride * period))
        return np.array([period, self.transition, *shares, settling, stride, block, self.sigma])
