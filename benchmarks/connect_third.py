"""Plants drawn at random among distractors, right or with one fault, to measure `connect` on.

``drawn(seed)`` is a plant whose labels are right: names in six languages or tags, units and ranges
stated or not, a valve with overlap, play and lag, and beside its signals the pressures of other
pumps, pilot and tank lines, positions, counts and setpoints. ``faulty(seed)`` has one fault of
`KINDS` that no name shows.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.connect_plants import NAMES, SECONDS, UNITS, Floats, Plant, behind, raw_of
from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.reading import Record

KINDS: Final = ("return line", "other pump", "half", "double", "unsigned", "tenth", "lagging")
"""Faults: p2 is the return line's while a load is behind the valve; p1 that of a pump that does not
feed it; p1 with half or double its scale; a meter without a sign at a flow that reverses; Q
a tenth of what it is, beside a name plate; a pressure behind another valve in place of p2."""

_OPEN: Final = 5.0  # %, and bar

OTHERS: Final[Mapping[str, tuple[str, ...]]] = {
    "German": ("Druck Pumpe 2", "Tankleitung Druck", "Kühlkreis Druck", "Druck Filter"),
    "English": ("pump 2 pressure", "tank line pressure", "cooling pressure", "filter pressure"),
    "French": ("Pression pompe 2", "Pression filtre", "Pression refroidissement", "Niveau"),
    "Spanish": ("Presión bomba 2", "Presión filtro", "Presión refrigeración", "Nivel"),
    "Italian": ("Pressione pompa 2", "Pressione filtro", "Pressione raffreddamento", "Livello"),
    "Chinese": ("2号泵压力", "过滤器压力", "冷却压力", "液位"),
    "tags": ("PT-901 PUMP", "PT-902 FILTER", "PT-903 COOLER", "LT-904"),
}
"""Pressures and levels that are none of the valve's."""


def drawn(seed: int) -> Plant:
    """Return a plant whose labels are right."""
    rng = np.random.default_rng([20_261_127, seed])
    true = _signals(rng)
    plate = _plate(true) if seed % 2 else Rating()
    return replace(_plant(rng, true, "right"), rating=plate)


def faulty(seed: int, kind: str) -> Plant:
    """Return a plant with one fault."""
    rng = np.random.default_rng([20_261_128, seed])
    true = _signals(rng, reverses=kind == "unsigned")
    shown = _FAULTS[kind](rng, true)
    plate = _plate(true) if kind == "tenth" else Rating()
    return replace(_plant(rng, {**true, **shown}, kind), asks=True, rating=plate)


def _plate(true: Mapping[str, Floats]) -> Rating:
    """Return the name plate of a valve whose flow grows with U to the power 1.2."""
    dp = true["p1"] - true["p2"]
    opened = (true["U"] > _OPEN) & (dp > _OPEN)
    most = np.quantile(
        true["Q"][opened] / np.sqrt(dp[opened]) / (true["U"][opened] / 100) ** 1.2, 0.9
    )
    return Rating(flow_l_min=float(most) * 35**0.5, drop_bar=35.0)


def _signals(rng: np.random.Generator, *, reverses: bool = False) -> dict[str, Floats]:
    """Return a valve's true signals over ten seconds, in our units, with sensors' noise."""
    step = 0.05
    t = np.arange(0.0, SECONDS, step)
    U = _command(rng, t)
    supply, share = float(rng.uniform(80, 280)), rng.uniform(0.35, 0.75)
    wave = _wave(rng, t)
    load = supply * (share * (0.5 + 0.5 * wave) + 0.08)
    if reverses:
        load = supply * (1.0 + 0.4 * wave) * rng.uniform(0.85, 1.0)
    droop = rng.uniform(0.02, 0.15) * supply
    spool = behind(_played(U, rng.uniform(0.0, 4.0)), rng.uniform(0.0, 0.03), step)
    p1 = supply - droop * np.clip(spool, 0, None) / 100.0 + 0.01 * supply * _wave(rng, t)
    k = float(np.exp(rng.uniform(np.log(0.8), np.log(14.0))))
    opened = k * np.clip((spool - rng.uniform(0, 8)) / 100.0, 0, None) ** rng.uniform(0.9, 1.6)
    dp = p1 - load
    Q = behind(opened * np.sign(dp) * np.sqrt(np.abs(dp)), float(rng.choice([0, 0.05, 0.2])), step)
    noise = 0.002 * supply
    rows = len(t)
    return {
        "t": t,
        "U": U,
        "p1": p1 + rng.normal(0, noise, rows),
        "p2": load + rng.normal(0, noise, rows),
        "Q": Q + rng.normal(0, 0.005 * max(float(np.abs(Q).max()), 1.0), rows),
        "T": 38 + 14 * rng.uniform() + 0.02 * t,
    }


def _command(rng: np.random.Generator, t: Floats) -> Floats:
    match int(rng.integers(4)):
        case 0:
            return np.asarray(50 + 32 * np.sin(rng.uniform(0.6, 3) * t) + 12 * np.sin(4.1 * t))
        case 1:
            return np.asarray(rng.uniform(10, 95, 40)[(t / rng.uniform(0.5, 1.5)).astype(int)])
        case 2:
            return np.asarray(10 + 85 * (1 - np.abs((t * rng.uniform(0.15, 0.4)) % 2 - 1)))
        case _:
            levels = rng.choice([0.0, 30.0, 60.0, 95.0], 40)
            return behind(levels[(t / 0.8).astype(int)], 0.15, float(t[1]))


def _wave(rng: np.random.Generator, t: Floats) -> Floats:
    """Return a movement within -1 … 1: two waves."""
    first, second = rng.uniform(0.8, 2.5), rng.uniform(2.0, 5.0)
    phase = rng.uniform(0, 6, 2)
    return np.asarray(0.7 * np.sin(first * t + phase[0]) + 0.3 * np.sin(second * t + phase[1]))


def _played(U: Floats, width: float) -> Floats:
    """Return what follows U through a play of this width."""
    found, at = np.empty_like(U), float(U[0])
    for i, u in enumerate(U):
        at = min(max(at, u - width / 2), u + width / 2)
        found[i] = at
    return found


def _of_return_line(rng: np.random.Generator, true: Mapping[str, Floats]) -> dict[str, Floats]:
    rows = len(true["t"])
    flow = true["Q"] / max(float(true["Q"].max()), 1.0)
    return {"p2": rng.uniform(1, 5) + rng.uniform(0, 3) * flow + rng.normal(0, 0.05, rows)}


def _of_other_pump(rng: np.random.Generator, true: Mapping[str, Floats]) -> dict[str, Floats]:
    level = float(true["p1"].max()) * rng.uniform(1.0, 1.5)
    own = level * (1 - rng.uniform(0.1, 0.3) * (0.5 + 0.5 * _wave(rng, true["t"])))
    return {"p1": own + rng.normal(0, 0.2, len(own))}


def _scaled(role: str, factor: float) -> Callable[..., dict[str, Floats]]:
    def fault(_: np.random.Generator, true: Mapping[str, Floats]) -> dict[str, Floats]:
        return {role: factor * true[role]}

    return fault


def _unsigned(_: np.random.Generator, true: Mapping[str, Floats]) -> dict[str, Floats]:
    return {"Q": np.abs(true["Q"])}


def _of_other_load(rng: np.random.Generator, true: Mapping[str, Floats]) -> dict[str, Floats]:
    top = float(true["p2"].max())
    own = top * (0.55 + 0.45 * _wave(rng, true["t"]))
    return {"p2": own + rng.normal(0, 0.2, len(own))}


_FAULTS: Final[Mapping[str, Callable[..., dict[str, Floats]]]] = dict(
    zip(
        KINDS,
        (
            _of_return_line, _of_other_pump, _scaled("p1", 0.5), _scaled("p1", 2.0), _unsigned,
            _scaled("Q", 0.1), _of_other_load,
        ),
        strict=True,
    )
)  # fmt: skip


def _plant(rng: np.random.Generator, shown: Mapping[str, Floats], kind: str) -> Plant:
    """Name a valve's signals, and add the variables beside it."""
    language = str(rng.choice(list(NAMES)))
    names, loop = NAMES[language], int(rng.integers(101, 900))
    units = {role: str(rng.choice(choices)) for role, choices in UNITS.items()}
    stated = str(rng.choice(["property", "property", "brackets", "suffix"]))
    has_ranges = rng.uniform() < 0.5
    folder = ("Plant", f"Unit {rng.integers(1, 9)}") if language != "tags" else ("Tags",)
    candidates: list[Candidate] = []
    values: dict[str, Floats] = {}

    def add(name: str, own: Floats, unit: str, top: float | None = None) -> str:
        raw, bounds = raw_of(own, unit) if unit else (own, None)
        known, plain = unit_of(unit.removeprefix("±")), unit.removeprefix("±")
        if bounds == (0.0, 1.0):
            bounds = None if top is None else (0.0, float(raw_of(np.array([top]), unit)[0][0]))
        label = name
        if stated == "brackets" and plain:
            label = f"{name} [{plain}]"
        if stated == "suffix" and plain:
            label = f"{name} [0-1]" if plain == "1" else f"{name}_{plain.replace('³', '3')}"
        symbol = plain if known is None and stated == "property" else ""
        node = f"n{len(candidates)}"
        of_property = known if stated == "property" else None
        candidates.append(Candidate(node, (*folder, label), of_property, bounds, symbol=symbol))
        values[node] = raw
        return node

    def name_of(role: str) -> str:
        return str(rng.choice(list(names[role]))).format(n=loop)

    truth = {}
    for role in ("U", "p1", "p2", "Q", "T"):
        own, unit = shown[role], units[role if role in {"U", "Q", "T"} else "p"]
        top = None
        if has_ranges and role in {"p1", "Q"} and not (own < -0.5).any():
            top = _round_up(float(own.max()) * rng.uniform(1.05, 1.8))
        truth[role] = (add(name_of(role), own, unit, top), own)
    _beside(rng, add, name_of, OTHERS[language], shown)
    order = rng.permutation(len(candidates))
    return Plant(
        f"{kind}, {language}, {stated}",
        tuple(candidates[i] for i in order),
        Record(values, float(shown["t"][1])),
        {"V": truth},
    )


def _beside(
    rng: np.random.Generator,
    add: Callable[..., str],
    name_of: Callable[[str], str],
    others: tuple[str, ...],
    shown: Mapping[str, Floats],
) -> None:
    """Add the distractors."""
    t = shown["t"]
    rows = len(t)
    made = {
        "spool": (shown["U"] + rng.normal(0, 0.3, rows), "%"),
        "pilot": (30 + rng.normal(0, 0.2, rows), "bar"),
        "position": (200 + 80 * _wave(rng, t), "mm"),
        "speed": (1480 + rng.normal(0, 3, rows), "rpm"),
        "setpoint": (np.full(rows, float(rng.uniform(10, 200))), ""),
        "other": (np.full(rows, float(rng.uniform(10, 200))), ""),
    }
    for role in rng.choice(list(made), 3, replace=False):
        own, unit = made[str(role)]
        add(name_of(str(role)), own, unit)
    for name in rng.choice(list(others), 2, replace=False):
        level = float(rng.uniform(3, 200))
        add(str(name), level * (1 + 0.05 * _wave(rng, t)), "bar" if rng.uniform() < 0.8 else "")


def _round_up(value: float) -> float:
    """Return the next of 1, 1.6, 2.5, 4, 6, 10 and their multiples by ten."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(s for s in (1, 1.6, 2.5, 4, 6, 10) if s * decade >= value) * decade)
