"""What a machine does: a programme of moves and of loads, both functions of the sample number."""

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from valvemap_rig.parameters import Parameters
from valvemap_rig.randomness import uniform
from valvemap_rig.records import Floats

_PEAK = 1.875  # highest over mean speed of the move 10s³ - 15s⁴ + 6s⁵


class Programme(Parameters):
    """Moves between random places, each followed by a rest: one move per ``period_s``."""

    period_s: float = Field(default=3.0, ge=0.2, le=600, description="from move to move")
    low: float = Field(default=0.08, ge=0, le=1, description="lowest place, share of the stroke")
    high: float = Field(default=0.92, ge=0, le=1, description="highest place")
    speed_mm_s: float = Field(
        default=450.0, gt=0, le=5000, description="of a move that fits in a period"
    )
    rest: float = Field(default=0.5, ge=0, le=0.95, description="longest rest, share of a period")


class Load(Parameters):
    """A force against extension: a part constant over each move, and two slow sines."""

    mean_N: float = Field(default=3000.0, ge=-1e6, le=1e6)
    moves_N: float = Field(default=9000.0, ge=0, le=1e6, description="± random, move by move")
    sine_N: float = Field(default=4000.0, ge=0, le=1e6, description="amplitude of both sines")
    period_s: float = Field(default=7.3, ge=0.1, le=1e4, description="of the slower sine")


def moves(
    programme: Programme,
    stroke_mm: float,
    index: NDArray[np.int64],
    rate: float,
    seed: int,
    name: str,
) -> tuple[Floats, Floats]:
    """Return set position (mm) and set speed (mm/s) at N consecutive samples.

    >>> x, v = moves(Programme(rest=0), 800.0, np.arange(251), 100.0, 1, "V")
    >>> bool(abs(np.diff(x).max() * 100 - v.max()) < 1)
    True
    """
    number, phase_s = _split(index, programme.period_s, rate)
    places = programme.low + (programme.high - programme.low) * _draw(
        seed, f"{name}.places", number, 2
    )
    places = places * stroke_mm
    start, end = places[:, 0], places[:, 1]
    rest = programme.rest * _draw(seed, f"{name}.rests", number, 1)[:, 0]
    longest = programme.period_s * (1.0 - rest)
    need = np.abs(end - start) * _PEAK / programme.speed_mm_s
    length = np.minimum(np.maximum(longest, need), programme.period_s)
    s = np.clip(phase_s / length, 0.0, 1.0)
    step = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    speed = 30.0 * s * s * (1.0 - s) * (1.0 - s) / length
    return start + (end - start) * step, (end - start) * speed


def forces(
    load: Load, index: NDArray[np.int64], period_s: float, rate: float, seed: int, name: str
) -> Floats:
    """Return the load (N) at N consecutive samples; it changes in the first fifth of a period."""
    number, phase_s = _split(index, period_s, rate)
    levels = load.moves_N * (2.0 * _draw(seed, f"{name}.loads", number, 2) - 1.0)
    s = np.clip(phase_s / (0.2 * period_s), 0.0, 1.0)
    level = levels[:, 0] + (levels[:, 1] - levels[:, 0]) * s * s * (3.0 - 2.0 * s)
    t = index / rate
    slow = 2.0 * math.pi * t / load.period_s
    return np.asarray(
        load.mean_N + level + load.sine_N * (np.sin(slow) + 0.5 * np.sin(2.718 * slow + 1.0))
    )


def _split(
    index: NDArray[np.int64], period_s: float, rate: float
) -> tuple[NDArray[np.int64], Floats]:
    samples = max(1, round(period_s * rate))
    return index // samples, (index % samples) / rate


def _draw(seed: int, stream: str, number: NDArray[np.int64], n: int) -> Floats:
    """Return (N, n): the random number of each period and of the n - 1 after it."""
    if number.size == 0:
        return np.empty((0, n))
    first = int(number[0])
    drawn = uniform(seed, stream, first, int(number[-1]) - first + n)
    return np.stack([drawn[number - first + k] for k in range(n)], axis=1)
