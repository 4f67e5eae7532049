"""Excitations of the rig: the valve's signal U (%) and the load valve's set point p2 (bar).

Every excitation is a function of the sample number only, so that blocks can be computed
independently. ``external`` receives U from a client.
"""

from typing import Annotated, Literal, assert_never

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from valvemap_rig.parameters import Parameters
from valvemap_rig.randomness import uniform
from valvemap_rig.records import Floats

Percent = Annotated[float, Field(ge=0, le=100)]
Bar = Annotated[float, Field(ge=0, le=400)]
Seconds = Annotated[float, Field(ge=0.001, le=86_400)]


class CyclePoint(Parameters):
    """A corner of the working cycle; between corners everything runs straight."""

    at: float = Field(ge=0, le=1, description="share of the cycle's period")
    U_percent: Percent
    p2_bar: Bar


class Structured(Parameters):
    """U in steps; at each step p2 is swept from high to low and back (quasi-static)."""

    kind: Literal["structured"] = "structured"
    levels_percent: tuple[Percent, ...] = Field(
        default=tuple(10.0 * k for k in range(11)), min_length=1, max_length=1000
    )
    sweep_s: Seconds = Field(default=20.0, description="time at each level: p2 down and up")
    p2_low_bar: Bar = 0.0
    p2_high_bar: Bar = 200.0


class Scattered(Parameters):
    """Points spread evenly at random over U and the pressure drop p0 - p2."""

    kind: Literal["scattered"] = "scattered"
    hold_s: float = Field(
        default=0.0, ge=0, le=3600, description="time at each point; 0 = one sample each"
    )
    U_low_percent: Percent = 0.0
    U_high_percent: Percent = 100.0
    dp_low_bar: Bar = 0.0
    dp_high_bar: Bar = 200.0


class Verification(Parameters):
    """Points that are in neither: a low-discrepancy sequence (R2) over U and the pressure drop."""

    kind: Literal["verification"] = "verification"
    points: int = Field(default=1000, ge=1, le=100_000, description="then they repeat")
    hold_s: float = Field(
        default=0.0, ge=0, le=3600, description="time at each point; 0 = one sample each"
    )


_MACHINE = (
    CyclePoint(at=0.00, U_percent=0, p2_bar=190),
    CyclePoint(at=0.06, U_percent=65, p2_bar=105),  # rapid advance
    CyclePoint(at=0.26, U_percent=70, p2_bar=115),
    CyclePoint(at=0.30, U_percent=35, p2_bar=120),  # working stroke against a rising load
    CyclePoint(at=0.52, U_percent=45, p2_bar=165),
    CyclePoint(at=0.56, U_percent=9, p2_bar=180),  # holding pressure
    CyclePoint(at=0.68, U_percent=8, p2_bar=182),
    CyclePoint(at=0.74, U_percent=62, p2_bar=90),  # rapid return
    CyclePoint(at=0.92, U_percent=58, p2_bar=95),
    CyclePoint(at=0.96, U_percent=0, p2_bar=190),  # pause
    CyclePoint(at=1.00, U_percent=0, p2_bar=190),
)


class Cycle(Parameters):
    """The working cycle of a machine, repeated; speed varies from cycle to cycle."""

    kind: Literal["cycle"] = "cycle"
    period_s: Seconds = 20.0
    variation: float = Field(
        default=0.1, ge=0, le=1, description="share by which U is lowered at random, cycle by cycle"
    )
    points: tuple[CyclePoint, ...] = Field(default=_MACHINE, min_length=2, max_length=1000)


class External(Parameters):
    """U comes from outside; p2 is swept up and down, or held if both its ends are equal."""

    kind: Literal["external"] = "external"
    U_start_percent: Percent = Field(default=0.0, description="U while none is commanded")
    sweep_s: Seconds = 20.0
    p2_low_bar: Bar = 100.0
    p2_high_bar: Bar = 100.0


Excitation = Annotated[
    Structured | Scattered | Verification | Cycle | External, Field(discriminator="kind")
]


def drive(
    excitation: Excitation,
    index: NDArray[np.int64],
    sample_rate_hz: float,
    p0_bar: float,
    seed: int,
    valve: str,
    external_U: float,
) -> tuple[Floats, Floats]:
    """Return U (%) and the p2 set point (bar), both (N,), of N consecutive samples ``index``.

    >>> U, p2 = drive(Structured(), np.arange(0, 22_000, 5_000), 100.0, 200.0, 1, "V", 0.0)
    >>> U, p2
    (array([  0.,  20.,  50.,  70., 100.]), array([200.,   0., 200.,   0., 200.]))
    """
    match excitation:
        case Structured():
            number, phase = _periods(index, excitation.sweep_s, sample_rate_hz)
            levels = np.array(excitation.levels_percent)
            return levels[number % len(levels)], _swept(excitation, phase)
        case Scattered():
            number = _held(index, excitation.hold_s, sample_rate_hz)
            share_U = _random(seed, f"{valve}.U points", number)
            share_dp = _random(seed, f"{valve}.dp points", number)
            U = _between(excitation.U_low_percent, excitation.U_high_percent, share_U)
            dp = _between(excitation.dp_low_bar, excitation.dp_high_bar, share_dp)
            return U, p0_bar - dp
        case Verification():
            number = _held(index, excitation.hold_s, sample_rate_hz) % excitation.points
            U, dp = low_discrepancy_points(number, p0_bar)
            return U, p0_bar - dp
        case Cycle():
            number, phase = _periods(index, excitation.period_s, sample_rate_hz)
            slower = excitation.variation * _random(seed, f"{valve}.cycles", number)
            at = [point.at for point in excitation.points]
            U = np.interp(phase, at, [point.U_percent for point in excitation.points])
            p2 = np.interp(phase, at, [point.p2_bar for point in excitation.points])
            return U * (1 - slower), p2
        case External():
            _, phase = _periods(index, excitation.sweep_s, sample_rate_hz)
            return np.full(index.shape, external_U, np.float64), _swept(excitation, phase)
        case _:
            assert_never(excitation)


def low_discrepancy_points(number: NDArray[np.int64], p0_bar: float) -> tuple[Floats, Floats]:
    """Return points ``number`` (0 …) of the R2 sequence (Roberts 2018) over U (%), dp (bar)."""
    k = number.astype(np.float64) + 1.0  # point 0 would be the centre
    U = (0.5 + 0.7548776662466927 * k) % 1.0
    dp = (0.5 + 0.5698402909980532 * k) % 1.0
    return 100.0 * U, p0_bar * dp


def _periods(
    index: NDArray[np.int64], period_s: float, rate: float
) -> tuple[NDArray[np.int64], Floats]:
    """Return the period number and the phase (0 … 1) of each sample."""
    samples = max(1, round(period_s * rate))
    return index // samples, (index % samples) / samples


def _held(index: NDArray[np.int64], hold_s: float, rate: float) -> NDArray[np.int64]:
    return index // max(1, round(hold_s * rate))


def _swept(excitation: Structured | External, phase: Floats) -> Floats:
    return _between(excitation.p2_low_bar, excitation.p2_high_bar, np.abs(2 * phase - 1))


def _between(low: float, high: float, share: Floats) -> Floats:
    return low + (high - low) * share


def _random(seed: int, stream: str, number: NDArray[np.int64]) -> Floats:
    """Return the random number of each point; ``number`` must not decrease."""
    if number.size == 0:
        return np.empty(0)
    first = int(number[0])
    return uniform(seed, stream, first, int(number[-1]) - first + 1)[number - first]
