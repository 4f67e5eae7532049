"""A 4/3 valve with unlike edges on a cylinder: an independent truth for valves with ports.

Flows are steady at the pressures that hold the load, chambers are stiff. The valve has overlaps,
play, a spool of second order and leakage between the lines; each line has a meter.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SIGMA: Final = 0.4  # l/min
GAINS: Final[dict[str, Callable[[Floats], Floats]]] = {  # l/min/√bar by the opening, 0 … 1
    "PA": lambda u: 12.0 * u**1.2,
    "AT": lambda u: 11.0 * (0.5 * u + 0.5 * u * u),
    "PB": lambda u: 10.0 * u**1.1,
    "BT": lambda u: 9.0 * (0.4 * u + 0.6 * u * u),
}
OVERLAPS: Final = {"PA": 8.0, "AT": 7.0, "PB": 8.0, "BT": 6.0}  # %
AREAS: Final = 31.2e-4, 15.3e-4  # m²; piston 63 mm, rod 45 mm
FREQUENCY, DAMPING = 40.0, 0.8  # Hz
FLOW: Final = 60_000.0  # l/min of one m³/s


@dataclass(frozen=True)
class Valve:
    """The valve: gains of its edges over the original ones, play (%), leakage (l/min/bar)."""

    gain: dict[str, float] = field(default_factory=lambda: dict.fromkeys(GAINS, 1.0))
    play: float = 1.0
    leakage: float = 0.01

    def flow(self, edge: str, U: Floats, dp: Floats) -> Floats:
        """Flow through an edge (N,), l/min, at |U| of the spool and its pressure drop."""
        opening = np.clip((np.abs(U) - OVERLAPS[edge]) / (100.0 - OVERLAPS[edge]), 0.0, 1.0)
        root = np.sign(dp) * np.sqrt(np.abs(dp))
        return np.asarray(self.gain[edge] * GAINS[edge](opening) * root)


def work(seconds: float, rate_hz: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """U (%) of a machine at work: moves, creeping, pauses; and the load on its cylinder (N)."""
    n = round(seconds * rate_hz)
    U, at = np.zeros(n), 0
    now = 0.0
    while at < n:
        kind = rng.random()
        target = 0.0
        if kind < 0.55:
            target = rng.choice([-1.0, 1.0]) * rng.uniform(15.0, 100.0)
        elif kind < 0.75:
            target = rng.choice([-1.0, 1.0]) * rng.uniform(6.0, 25.0)
        stay = rng.uniform(0.3, 3.0) if target else rng.uniform(0.2, 1.2)
        slew = rng.uniform(60.0, 400.0)
        steps = max(round(abs(target - now) / slew * rate_hz), 1)
        path = np.concatenate(
            [np.linspace(now, target, steps), np.full(round(stay * rate_hz), target)]
        )
        some = min(len(path), n - at)
        U[at : at + some] = path[:some]
        at, now = at + some, target
    t = np.arange(n) / rate_hz
    load = 14e3 + 9e3 * np.sin(2 * np.pi * t / rng.uniform(17.0, 23.0))
    load += np.repeat(rng.normal(0.0, 7e3, n // 400 + 1), 400)[:n]
    return U, load


def spool_of(U: Floats, rate_hz: float, play: float) -> Floats:
    """Position of the spool (%), behind a lag of second order and play."""
    h, steps = 1.0 / rate_hz, 20
    w, x, v, p = 2.0 * np.pi * FREQUENCY, float(U[0]), 0.0, float(U[0])
    found = np.empty_like(U)
    for k, u in enumerate(U):
        for _ in range(steps):
            p = min(max(p, u - 0.5 * play), u + 0.5 * play)
            v += h / steps * (w * w * (p - x) - 2.0 * DAMPING * w * v)
            v = min(max(v, -5_000.0), 5_000.0)
            x += h / steps * v
        found[k] = x
    return found


def measured(
    valve: Valve, U: Floats, load: Floats, rate_hz: float, rng: np.random.Generator,
    sigma: float = SIGMA,
) -> dict[str, Floats]:  # fmt: skip
    """Return the recording of the valve by column: t, U, pP, pT, pA, pB, QA, QB, T."""
    n = len(U)
    spool = spool_of(U, rate_hz, valve.play)
    pT = 4.0 + 0.5 * np.sin(np.arange(n) / rate_hz / 7.0)
    pP = 180.0 - 20.0 * np.abs(U) / 100.0 + rng.normal(0.0, 0.2, n)
    A, B = AREAS
    ones = np.ones(n)
    k = {edge: np.maximum(valve.flow(edge, spool, ones), 1e-9) for edge in GAINS}
    out, back = spool > 0.0, spool < 0.0
    loss_out = A * (A * FLOW / k["PA"]) ** 2 + B * (B * FLOW / k["BT"]) ** 2
    loss_back = A * (A * FLOW / k["AT"]) ** 2 + B * (B * FLOW / k["PB"]) ** 2
    force = load * 1e-5  # bar·m²
    v_out = np.sqrt(np.maximum(pP * A - pT * B - force, 0.0) / loss_out)
    v_back = np.sqrt(np.maximum(pP * B - pT * A + force, 0.0) / loss_back)
    pA = np.where(
        out, pP - (A * FLOW * v_out / k["PA"]) ** 2, pT + (A * FLOW * v_back / k["AT"]) ** 2
    )
    pB = np.where(
        out, pT + (B * FLOW * v_out / k["BT"]) ** 2, pP - (B * FLOW * v_back / k["PB"]) ** 2
    )
    shut = np.abs(spool) <= min(OVERLAPS.values())
    pB = np.where(shut, 40.0 + 25.0 * np.sin(np.arange(n) / rate_hz / 3.0), pB)
    pA = np.where(shut, (force + pB * B) / A, pA)
    pA, pB = np.clip(pA, 0.0, 250.0), np.clip(pB, 0.0, 250.0)
    lost = valve.leakage * (pA - pB)
    QA = np.where(out, valve.flow("PA", spool, pP - pA), 0.0)
    QA -= np.where(back, valve.flow("AT", spool, pA - pT), 0.0) + lost
    QB = np.where(back, valve.flow("PB", spool, pP - pB), 0.0)
    QB -= np.where(out, valve.flow("BT", spool, pB - pT), 0.0) - lost
    noise = rng.normal(0.0, 1.0, (6, n))
    return {
        "t": np.arange(n) / rate_hz,
        "U": U,
        "pP": pP,
        "pT": pT + 0.02 * noise[1],
        "pA": pA + 0.02 * noise[2],
        "pB": pB + 0.02 * noise[3],
        "QA": QA + sigma * noise[4],
        "QB": QB + sigma * noise[5],
        "T": np.full(n, 42.0),
    }


def worn(valve: Valve, edge: str, by: float) -> Valve:
    """Return the valve with another gain of one edge."""
    return replace(valve, gain={**valve.gain, edge: valve.gain[edge] * by})
