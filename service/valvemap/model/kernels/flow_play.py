"""Play between U and the spool: the spool moves once U has taken up half of it.

    p = clip(p, U - h, U + h)

With another half play h_k, the spool would be at p_k instead of p, and the residual, measured
against a map that is the mean of both ways, would be slope·(p_k - p). Each h_k of a grid gains

    log L_k = Σ (r·x_k - x_k²/2) / σ²,   x_k = slope·(p_k - p)

of log likelihood over the one in use. The map of another one begins again; a small correction of
it is a step of Gauss and Newton on h itself.
"""

import math

from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.samples import Floats

GRID = rules.HALF_PLAYS
MANY = len(GRID)

# Places in `play`.
HALF, SPOOL, SLOPES, ERRORS, SEEN = 0, 1, 2, 3, 4  # h, p; Σ x², Σ r·x of h itself; samples
SPOOLS = 5  # p_k, MANY places
GAINS = SPOOLS + MANY  # log L_k, MANY places
PLACES = GAINS + MANY


@inner
def follow(play: Floats, U: float) -> float:
    """Move the spool; give where it is."""
    if play[SEEN] == 0.0:
        play[SPOOL] = U
        for k in range(MANY):
            play[SPOOLS + k] = U
    play[SEEN] += 1.0
    play[SPOOL] = min(max(play[SPOOL], U - play[HALF]), U + play[HALF])
    for k in range(MANY):
        play[SPOOLS + k] = min(max(play[SPOOLS + k], U - GRID[k]), U + GRID[k])
    return float(play[SPOOL])


@inner
def weigh(play: Floats, U: float, residual: float, slope: float, variance: float) -> None:
    """Add what a residual says of each half play; ``slope`` is dQ/dp."""
    limit = rules.MOST_STAY * math.sqrt(variance)
    r = min(max(residual, -limit), limit)
    for k in range(MANY):
        x = slope * (play[SPOOLS + k] - play[SPOOL])
        x = min(max(x, -limit), limit)
        gain = (r * x - 0.5 * x * x) / variance
        play[GAINS + k] = rules.PLAY_KEPT * play[GAINS + k] + gain
    behind = U - play[SPOOL]
    if play[HALF] > 0.0 and abs(behind) > 0.99 * play[HALF]:  # p = U - h·sign
        x = -slope if behind > 0.0 else slope
        play[SLOPES] = rules.PLAY_KEPT * play[SLOPES] + x * x / variance
        play[ERRORS] = rules.PLAY_KEPT * play[ERRORS] + r * x / variance


@inner
def decide(play: Floats) -> bool:
    """Take another half play where it is likelier by far; True: the map has to begin again."""
    best, most = -1, rules.PLAY_GAIN if play[HALF] == 0.0 else rules.PLAY_AGAIN
    for k in range(MANY):
        if play[GAINS + k] > most:
            best, most = k, play[GAINS + k]
    if best >= 0:
        half = GRID[best]
        if 0 < best < MANY - 1:  # the top of a parabola through three of unequal distance
            left, right = half - GRID[best - 1], GRID[best + 1] - half
            fall_left = (most - play[GAINS + best - 1]) / left
            fall_right = (most - play[GAINS + best + 1]) / right
            half += (
                0.5 * (fall_left * right - fall_right * left) / max(fall_left + fall_right, 1e-300)
            )
        is_far = bool(abs(half - play[HALF]) > rules.PLAY_STEP)
        play[HALF] = min(max(half, 0.0), GRID[MANY - 1])
        play[SPOOL] = play[SPOOLS + best]
        _forget(play)
        return is_far
    if play[SLOPES] > 0.0:
        off = play[ERRORS] / play[SLOPES]
        if off * off * play[SLOPES] > rules.SURE**2 and abs(off) < rules.PLAY_STEP:
            play[HALF] = min(max(play[HALF] + off, 0.0), GRID[MANY - 1])
            _forget(play)
    return False


@lean_kernel
def behind(half: float, U: Floats, out: Floats) -> None:
    """Where in its play (-1 … 1) the spool is along a path of N values of U, at 0 at first."""
    spool = math.nan
    for i in range(len(U)):
        if math.isfinite(U[i]):
            spool = min(max(spool, U[i] - half), U[i] + half) if math.isfinite(spool) else U[i]
        out[i] = (U[i] - spool) / half if math.isfinite(U[i]) else 0.0


@inner
def _forget(play: Floats) -> None:
    play[SLOPES] = play[ERRORS] = 0.0
    for k in range(MANY):
        play[GAINS + k] = 0.0
