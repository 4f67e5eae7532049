"""How often `fit` and `replay` refuse units that are right, and accept ones that are wrong.

``python -m benchmarks.stated_units [--seeds FIRST LAST]`` draws valves of `benchmarks.connect`
whose columns are named ``U,p1,p2,Q``: with right units, and with one that is wrong, without and
with the name plate's flow, rounded to two digits. A refusal's
remedy is obeyed: the units that it names are given, and the recording is judged again.
"""

import argparse
import ast
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.connect_plants import signals
from valvemap.app.given import layout_of
from valvemap.app.recorded_units import check_units
from valvemap.errors import RecordingError
from valvemap.model.samples import Samples
from valvemap.pipeline.units import Measure, unit_of
from valvemap.plant.evidence import RATED_DROP_BAR, Rating
from valvemap.storage.column_finding import find_columns

HELD_OUT: Final = (80_000, 80_060)
"""Seeds of the reported figures."""
STEP_S: Final = 0.02
EXCITATIONS: Final = ("sines", "steps", "ramp", "work")
RIGHT: Final = (
    {"p1": "bar", "p2": "bar", "Q": "l/min"},
    {"p1": "psi", "p2": "psi", "Q": "gpm"},
    {"p1": "MPa", "p2": "MPa", "Q": "l/min"},
    {"p1": "kPa", "p2": "kPa", "Q": "m³/h"},
)
WRONG: Final[Mapping[str, Mapping[str, str]]] = {
    "pressures in bar, stated Pa": {"p1": "Pa", "p2": "Pa"},
    "pressures in bar, stated kPa": {"p1": "kPa", "p2": "kPa"},
    "pressures in bar, stated MPa": {"p1": "MPa", "p2": "MPa"},
    "one pressure in bar, stated psi": {"p1": "psi"},
    "one pressure in bar, stated MPa": {"p2": "MPa"},
    "Q in l/min, stated l/s": {"Q": "l/s"},
    "Q in l/min, stated m³/h": {"Q": "m³/h"},
    "U in %, stated as a ratio": {"U": "ratio"},
}
SIGNALS: Final = ("U", "p1", "p2", "Q")


def judged(
    values: Mapping[str, np.ndarray], units: Mapping[str, str], rating: Rating | None = None
) -> str:
    """Return the refusal of values in stated units; empty if they are accepted."""
    part = find_columns(["t", *SIGNALS], layout_of(dict(units), None), "drawn").parts[0]
    inner = {name: part.numbers[name][1](values[name]) for name in SIGNALS}
    t = 1_767_225_600 * 10**9 + np.arange(len(values["U"])) * round(STEP_S * 1e9)
    try:
        check_units(Path("drawn"), "V", Samples.of(t=t, **inner), part, rating)
    except RecordingError as error:
        return str(error)
    return ""


def in_units(values: Mapping[str, np.ndarray], units: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return values of ours in other units."""
    found = {}
    for name in SIGNALS:
        scaling = Measure(unit=unit_of(units.get(name, ""))).scaling(name)
        found[name] = (values[name] - scaling.offset) / scaling.gain
    return found


def remedied(
    values: Mapping[str, np.ndarray], units: Mapping[str, str], rating: Rating | None, said: str
) -> str:
    """Return the refusal once the units that it names are given."""
    named = re.search(r"units=(\{.*?\})", said)
    return judged(values, {**units, **ast.literal_eval(named[1])}, rating) if named else said


def plate(values: Mapping[str, np.ndarray]) -> Rating:
    """Return the name plate of a drawn valve: its flow at U = 100 %, two digits."""
    opened = np.clip(values["U"], 5.0, None) / 100.0
    k = values["Q"] / np.sqrt(np.maximum(values["p1"] - values["p2"], 1.0)) / opened**1.2
    flow = float(np.quantile(k, 0.9)) * RATED_DROP_BAR**0.5
    return Rating(flow_l_min=float(f"{flow:.1e}"))


def main() -> None:
    """Print a row per set."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, nargs=2, default=HELD_OUT)
    drawn = []
    for seed in range(*parser.parse_args().seeds):
        rng = np.random.default_rng(seed)
        drawn.append(signals(rng, EXCITATIONS[seed % len(EXCITATIONS)], STEP_S))
    print("| stated | recordings | accepted | refused | its remedy, obeyed, is accepted |")
    print("|---|---|---|---|---|")
    for of, plates in (("", [None] * len(drawn)), (", name plate", [plate(x) for x in drawn])):
        pairs = list(zip(drawn, plates, strict=True))
        for units in RIGHT:
            told = [judged(in_units(one, units), units, rating) for one, rating in pairs]
            accepted = sum(not said for said in told)
            name = ", ".join(dict.fromkeys(units.values())) + of
            print(f"| right: {name} | {len(told)} | {accepted} | {len(told) - accepted} | - |")
        for name, units in WRONG.items():
            if of and "Q" not in units:
                continue
            found = Counter[str]()
            for one, rating in pairs:
                said = judged(one, units, rating)
                found["refused" if said else "accepted"] += 1
                found["works"] += bool(said) and not remedied(one, units, rating, said)
            counts = " | ".join(str(found[key]) for key in ("accepted", "refused", "works"))
            print(f"| {name}{of} | {len(drawn)} | {counts} |")


if __name__ == "__main__":
    main()
