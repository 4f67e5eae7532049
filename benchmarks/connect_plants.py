"""Plants for the benchmark of `connect`: names in six languages × units × shapes × excitation.

Seeded. A plant is what browsing would return and ten seconds of values, with the true assignment:
the values in our units of each learnt signal.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.units import Quantity, Unit, unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.reading import Record
from valvemap.plant.unit_texts import split_unit

Floats = NDArray[np.float64]
SECONDS: Final = 10.0

NAMES: Final[Mapping[str, Mapping[str, Sequence[str]]]] = {
    "German": {
        "U": ("Stellwert", "Stellsignal", "Ansteuerung Ventil", "Ventil Sollwert", "Stellgröße"),
        "p1": ("Druck vor", "Druck vor Ventil", "Zulaufdruck", "Versorgungsdruck", "Eingangsdruck"),
        "p2": ("Druck nach", "Druck nach Ventil", "Rücklaufdruck", "Tankdruck", "Ausgangsdruck"),
        "Q": ("Durchfluss", "Volumenstrom", "Durchflussmenge"),
        "T": ("Öltemperatur", "Temperatur Öl", "Temp"),
        "dp": ("Differenzdruck", "Druckdifferenz", "Druckabfall Ventil"),
        "spool": ("Schieberposition", "Schieberweg Ist"),
        "pilot": ("Steuerdruck", "Vorsteuerdruck"),
        "position": ("Zylinderweg", "Kolbenposition", "Position Zylinder"),
        "speed": ("Geschwindigkeit", "Drehzahl Pumpe"),
        "setpoint": ("Drucksollwert", "Sollwert Volumenstrom"),
        "other": ("Füllstand Tank", "Kraft", "Betriebsstunden", "Alarm Filter"),
    },
    "English": {
        "U": ("ValveCommand", "Valve cmd", "control signal", "valve_demand", "spool command"),
        "p1": ("InletPressure", "supply pressure", "p_in", "Upstream press", "p1"),
        "p2": ("OutletPressure", "return pressure", "p_out", "Downstream press", "p2"),
        "Q": ("FlowRate", "flow", "oil flow", "Q"),
        "T": ("OilTemperature", "oil temp", "temperature"),
        "dp": ("dp", "differential pressure", "pressure drop", "deltaP"),
        "spool": ("spool position", "SpoolPos", "spool feedback"),
        "pilot": ("pilot pressure", "PilotPress"),
        "position": ("cylinder position", "rod stroke", "position"),
        "speed": ("pump speed", "velocity", "rod speed"),
        "setpoint": ("pressure setpoint", "flow setpoint"),
        "other": ("tank level", "force", "operating hours", "alarm limit"),
    },
    "French": {
        "U": ("Consigne vanne", "Commande", "signal de commande", "Ouverture"),
        "p1": ("Pression amont", "Pression d'entrée", "Pression alimentation"),
        "p2": ("Pression aval", "Pression de sortie", "Pression retour"),
        "Q": ("Débit", "Débit huile"),
        "T": ("Température huile", "Température"),
        "dp": ("Pression différentielle", "Perte de charge pression"),
        "spool": ("Position tiroir", "Recopie tiroir"),
        "pilot": ("Pression de pilotage",),
        "position": ("Position vérin", "Course vérin"),
        "speed": ("Vitesse pompe", "Vitesse vérin"),
        "setpoint": ("Consigne pression", "Consigne débit"),
        "other": ("Niveau réservoir", "Force", "Heures", "Seuil alarme"),
    },
    "Spanish": {
        "U": ("Mando válvula", "Comando", "Apertura", "Señal de mando"),
        "p1": ("Presión de entrada", "Presión aguas arriba", "Presión suministro"),
        "p2": ("Presión de salida", "Presión aguas abajo", "Presión retorno"),
        "Q": ("Caudal", "Caudal aceite"),
        "T": ("Temperatura aceite", "Temperatura"),
        "dp": ("Presión diferencial", "Caída de presión"),
        "spool": ("Posición corredera",),
        "pilot": ("Presión de pilotaje", "Presión piloto"),
        "position": ("Posición cilindro", "Carrera cilindro"),
        "speed": ("Velocidad bomba", "Velocidad cilindro"),
        "setpoint": ("Consigna presión", "Consigna caudal"),
        "other": ("Nivel tanque", "Fuerza", "Contador horas", "Límite alarma"),
    },
    "Italian": {
        "U": ("Comando valvola", "Segnale comando", "Apertura valvola"),
        "p1": ("Pressione monte", "Pressione ingresso", "Pressione mandata"),
        "p2": ("Pressione valle", "Pressione uscita", "Pressione scarico"),
        "Q": ("Portata", "Portata olio"),
        "T": ("Temperatura olio", "Temperatura"),
        "dp": ("Pressione differenziale", "Differenza di pressione"),
        "spool": ("Posizione cursore",),
        "pilot": ("Pressione pilotaggio", "Pressione pilota"),
        "position": ("Posizione cilindro", "Corsa cilindro"),
        "speed": ("Velocità pompa", "Velocità cilindro"),
        "setpoint": ("Riferimento pressione", "Setpoint portata"),
        "other": ("Livello serbatoio", "Forza", "Contatore ore", "Soglia allarme"),
    },
    "Chinese": {
        "U": ("阀门开度", "控制信号", "阀指令"),
        "p1": ("阀前压力", "进口压力", "供油压力"),
        "p2": ("阀后压力", "出口压力", "回油压力"),
        "Q": ("流量", "油流量"),
        "T": ("油温", "温度"),
        "dp": ("压差", "阀压差"),
        "spool": ("阀芯位移", "阀芯位置"),
        "pilot": ("先导压力",),
        "position": ("油缸位移", "油缸行程"),
        "speed": ("泵转速", "油缸速度"),
        "setpoint": ("压力设定", "流量设定值"),
        "other": ("油箱液位", "力", "运行时间", "报警上限"),
    },
    "tags": {
        "U": ("FCV-{n}", "ZC-{n}", "MV{n}"),
        "p1": ("PT-{n} IN", "PT{n}_SUPPLY", "PI-{n}.1 supply"),
        "p2": ("PT-{n} OUT", "PT{n}_RETURN", "PI-{n}.2 return"),
        "Q": ("FT-{n}", "FIT{n}", "FI-{n}"),
        "T": ("TT-{n}", "TI{n}"),
        "dp": ("PDT-{n}", "PDI{n}"),
        "spool": ("LVDT-{n}",),
        "pilot": ("PT-{n} PILOT",),
        "position": ("CYL-POS-{n}",),
        "speed": ("SPEED-{n}",),
        "setpoint": ("PRESS-SP-{n}",),
        "other": ("LEVEL-{n}", "ALARM-{n}"),
    },
}
UNITS: Final = {
    "U": ("%", "%", "%", "1", "mA", "V", "±V"),
    "p": ("bar", "bar", "psi", "kPa", "MPa", "mbar"),
    "Q": ("l/min", "l/min", "gpm", "m³/h", "l/s", "cm³/s"),
    "T": ("°C", "°C", "°F", "K"),
}
EXTRA_UNITS: Final = {"spool": "%", "pilot": "bar", "position": "mm", "speed": "rpm"}
EXCITATIONS: Final = ("sines", "steps", "ramp", "work")
STATED: Final = ("property", "brackets", "suffix", "property", "both")


@dataclass(frozen=True)
class Plant:
    """What browsing and watching return, and the truth by valve and signal, in our units.

    ``asks`` is True where a question is the only right outcome; ``kind`` names the shape;
    ``rating`` is what the user gives of the name plate.
    """

    kind: str
    candidates: tuple[Candidate, ...]
    record: Record
    truth: Mapping[str, Mapping[str, tuple[str, Floats]]]
    asks: bool = False
    rating: Rating = field(default_factory=Rating)


@dataclass
class _Draft:
    candidates: list[Candidate] = field(default_factory=list)
    values: dict[str, Floats] = field(default_factory=dict)
    truth: dict[str, dict[str, tuple[str, Floats]]] = field(default_factory=dict)


def plant(seed: int, *, excitation: str | None = None, shape: str | None = None) -> Plant:
    """Return a plant whose labels are right."""
    rng = np.random.default_rng([20_261_124, seed])
    shape = shape or str(rng.choice(["folder", "folder", "flat", "block", "shared", "dp"]))
    language = str(rng.choice(list(NAMES))) if shape != "flat" else "tags"
    excitation = excitation or str(rng.choice(EXCITATIONS))
    step = float(rng.choice([0.02, 0.05, 0.1]))
    draft = _Draft()
    units = {kind: str(rng.choice(choices)) for kind, choices in UNITS.items()}
    stated = str(rng.choice(STATED))
    valves = int(rng.integers(2, 4)) if shape in {"shared", "flat"} else int(rng.integers(1, 4))
    for number in range(valves):
        _valve(draft, rng, language, shape, excitation, step, units, stated, number)
    if shape == "shared":
        _shared(draft, rng, language, units, stated)
    order = rng.permutation(len(draft.candidates))
    candidates = tuple(draft.candidates[i] for i in order)
    return Plant(f"{shape}, {language}", candidates, Record(draft.values, step), draft.truth)


def signals(
    rng: np.random.Generator, excitation: str, step: float, *, dp_only: bool = False
) -> dict[str, Floats]:
    """Return a valve's true signals over ten seconds, in our units, with sensors' noise."""
    t = np.arange(0.0, SECONDS, step)
    supply = float(rng.uniform(70, 280))
    back = float(rng.uniform(1, 0.2 * supply))
    U = _command(rng, excitation, t)
    load = back + 0.5 * (supply - back) * rng.uniform(0.2, 1.0) * (
        0.5 + 0.5 * np.sin(2 * np.pi * t * rng.uniform(0.1, 0.5) + rng.uniform(0, 6))
    )
    droop = rng.uniform(0.0, 0.15) * supply
    k = float(np.exp(rng.uniform(np.log(0.8), np.log(14.0))))
    opened = k * np.clip((U - rng.uniform(0, 8)) / 100.0, 0, None) ** rng.uniform(0.9, 1.6)
    p1 = supply - droop * U / 100.0
    dp = p1 - load
    Q = opened * np.sqrt(np.maximum(dp, 0.0))
    lag = float(rng.choice([0.0, 0.05, 0.2]))
    Q = behind(Q, lag, step)
    Q = Q + rng.normal(0, 0.005 * max(Q.max(), 1.0), len(t))
    noise = 0.002 * supply
    found = {
        "U": U,
        "p1": p1 + rng.normal(0, noise, len(t)),
        "p2": load + rng.normal(0, noise, len(t)),
        "Q": Q,
        "T": 38 + 14 * rng.uniform() + 0.02 * t,
    }
    if dp_only:
        found["dp"] = found.pop("p1") - found.pop("p2")
    return found


def _command(rng: np.random.Generator, excitation: str, t: Floats) -> Floats:
    match excitation:
        case "sines":
            return np.asarray(50 + 35 * np.sin(rng.uniform(0.6, 3) * t) + 10 * np.sin(4.1 * t))
        case "steps":
            levels = rng.uniform(10, 95, 40)
            return np.asarray(levels[(t / rng.uniform(0.5, 1.5)).astype(int)])
        case "ramp":
            return np.asarray(10 + 85 * (1 - np.abs((t * rng.uniform(0.15, 0.4)) % 2 - 1)))
        case "work":
            levels = rng.choice([0.0, 0.0, 30.0, 60.0, 95.0], 40)
            return behind(levels[(t / 0.8).astype(int)], 0.15, t[1] - t[0])
        case _:
            return np.full(len(t), rng.uniform(30, 80))


def behind(values: Floats, tau: float, step: float) -> Floats:
    """Return what follows values at steps of ``step`` s by a first-order lag of ``tau`` s."""
    if tau <= 0.0:
        return values
    found, state = np.empty_like(values, dtype=float), float(values[0])
    for i, v in enumerate(values):
        state += (1 - np.exp(-step / tau)) * (v - state)
        found[i] = state
    return found


def _valve(
    draft: _Draft,
    rng: np.random.Generator,
    language: str,
    shape: str,
    excitation: str,
    step: float,
    units: Mapping[str, str],
    stated: str,
    number: int,
) -> None:
    names = NAMES[language]
    true = signals(rng, excitation, step, dp_only=shape == "dp")
    loop = 101 + number
    folder = {"flat": ("Tags",), "block": ("PLC",)}.get(shape, ("Plant", f"Station {number + 1}"))

    def path(name: str) -> tuple[str, ...]:
        if shape == "block":
            return (*folder, f'"DB{10 + number}"."{name}"')
        return (*folder, name)

    chosen = {role: _name(rng, names, role, loop) for role in true}
    if shape == "shared":
        true.pop("p1"), true.pop("T")
    if rng.uniform() < 0.3:
        true.pop("T", None)
    valve: dict[str, tuple[str, Floats]] = {}
    for role, values in true.items():
        kind = role if role in {"U", "Q", "T"} else "p"
        node = _add(draft, rng, path, chosen[role], values, units[kind], stated, len(draft.values))
        valve[role] = (node, values)
    draft.truth[str(number)] = valve
    n = len(true["U"])
    for role in rng.choice(
        ["spool", "pilot", "position", "speed", "setpoint", "other"], 3, replace=False
    ):
        extra = _extra(rng, str(role), true, n)
        name = _name(rng, names, str(role), loop)
        unit = EXTRA_UNITS.get(str(role), "")
        _add(draft, rng, path, name, extra, unit, stated if unit else "none", len(draft.values))


def _extra(rng: np.random.Generator, role: str, true: Mapping[str, Floats], n: int) -> Floats:
    match role:
        case "spool":
            return true["U"] + rng.normal(0, 0.3, n)
        case "pilot":
            return 30 + rng.normal(0, 0.2, n)
        case "position":
            return 200 + np.cumsum(true["Q"] - true["Q"].mean()) * 0.05
        case "speed":
            return 1480 + rng.normal(0, 3, n)
        case _:
            return np.full(n, float(rng.uniform(10, 200)))


def _shared(
    draft: _Draft, rng: np.random.Generator, language: str, units: Mapping[str, str], stated: str
) -> None:
    """Give all valves one supply pressure: each valve's flow follows it."""
    names = NAMES[language]
    n = len(next(iter(draft.values.values())))
    supply = 300 + 5 * np.sin(np.linspace(0, 9, n))
    name = _name(rng, names, "p1", 1)
    node = _add(
        draft, rng, lambda own: ("Plant", own), name, supply, units["p"], stated, len(draft.values)
    )
    for valve in draft.truth.values():
        U, p2 = valve["U"][1], valve["p2"][1]
        flow_node, old = valve["Q"]
        Q = 0.05 * U * np.sqrt(supply - p2) * float(rng.uniform(0.5, 2))
        old_raw = draft.values[flow_node]
        gain = old_raw[np.argmax(old)] / old[np.argmax(old)]
        draft.values[flow_node] = Q * gain
        valve["Q"] = (flow_node, Q)
        place = next(i for i, one in enumerate(draft.candidates) if one.node == flow_node)
        draft.candidates[place] = replace(draft.candidates[place], bounds=None)
        valve["p1"] = (node, supply)


def _name(
    rng: np.random.Generator, names: Mapping[str, Sequence[str]], role: str, loop: int
) -> str:
    return str(rng.choice(list(names[role]))).format(n=loop)


def _add(
    draft: _Draft,
    rng: np.random.Generator,
    path: Callable[[str], tuple[str, ...]],
    name: str,
    values: Floats,
    unit_name: str,
    stated: str,
    number: int,
) -> str:
    """Add a variable with its values in a unit, stated one way or the other; return its node."""
    unit = unit_of(unit_name)
    raw, bounds = raw_of(values, unit_name)
    shown = unit_name.removeprefix("±")
    label, own, symbol = name, None, ""
    if stated in {"property", "both"}:
        own = unit
        symbol = shown if unit is None else ""
        if unit_name == "±V":
            own = unit_of("V")
    if stated in {"brackets", "both"} and shown:
        label = f"{name} [{shown}]"
    if stated == "suffix" and shown:
        label = f"{name} [0-1]" if shown == "1" else f"{name}_{shown.replace('³', '3')}"
    node = f"n{number}"
    is_electrical = unit_name in {"mA", "V", "±V"}
    has_bounds = is_electrical or rng.uniform() < 0.4
    if not is_electrical and bounds is not None:
        span = float(np.abs(raw).max()) * float(rng.uniform(1.1, 2.5))
        bounds = (
            (0.0, float(f"{span:.1g}")) if float(f"{span:.1g}") > np.abs(raw).max() else (0.0, span)
        )
    if np.nanmin(raw) < 0 and not is_electrical:
        has_bounds = False
    if unit_name in {"%", "1"} and has_bounds:
        bounds = (0.0, 100.0) if unit_name == "%" else (0.0, 1.0)
    draft.candidates.append(
        Candidate(node, path(label), own, bounds if has_bounds else None, symbol=symbol)
    )
    draft.values[node] = raw
    return node


def raw_of(values: Floats, unit_name: str) -> tuple[Floats, tuple[float, float] | None]:
    """Return values in a plant's unit, and the range of an electrical one."""
    match unit_name:
        case "mA":
            return 4 + 0.16 * values, (4.0, 20.0)
        case "V":
            return 0.1 * values, (0.0, 10.0)
        case "±V":
            return 0.1 * values, (-10.0, 10.0)
    unit = unit_of(unit_name)
    if unit is None or unit.quantity is Quantity.ELECTRICAL:
        return values, (0.0, 1.0)
    return (values - float(unit.offset)) / float(unit.factor), (0.0, 1.0)


FAULTS: Final = ("swapped", "× 10", "× 14.5", "× 60")


def contradicted(seed: int) -> Plant:
    """Return a plant of which a fault contradicts the law, a range, the rating or a magnitude.

    Two signals of one valve are swapped at the terminals, or a signal comes 10, 14.5 (pressures) or
    60 times (flows) too large for its unit and range.
    """
    rng = np.random.default_rng([7, seed])
    base = plant(seed, excitation=str(rng.choice(EXCITATIONS)), shape="folder")
    fault = FAULTS[seed % len(FAULTS)]
    valve = base.truth["0"]
    values = dict(base.record.values)
    candidates = list(base.candidates)
    if fault == "swapped":
        one, other = rng.choice(["U", "p1", "p2", "Q"], 2, replace=False)
        a, b = valve[str(one)][0], valve[str(other)][0]
        values[a], values[b] = values[b], values[a]
    else:
        factor = float(fault.removeprefix("× "))
        role = "Q" if fault == "× 60" else str(rng.choice(["p1", "Q"])) if fault == "× 10" else "p1"
        roles = ["p1", "p2"] if role == "p1" and rng.uniform() < 0.5 else [role]
        for name in roles:
            node = valve[name][0]
            place = next(i for i, one in enumerate(candidates) if one.node == node)
            top = float(np.abs(values[node]).max()) * float(rng.uniform(1.1, 2.5))
            if name == role:
                candidates[place] = replace(candidates[place], bounds=(0.0, top))
            values[node] = values[node] * factor
    return replace(
        base,
        kind=f"{base.kind}, {fault}",
        candidates=tuple(candidates),
        record=Record(values, base.record.step_s),
        asks=True,
    )


FLOW_UNITS: Final = ("l/min", "m³/h", "l/s", "cm³/s", "gpm")


def misstated(seed: int, *, wrong: bool = True) -> Plant:
    """Return a plant whose property states another unit of flow than the meter has, or its own.

    Nothing else states it, and no name plate is given.
    """
    base = plant(seed, shape="folder")
    rng = np.random.default_rng([11, seed])
    true, stated = (str(name) for name in rng.choice(FLOW_UNITS, 2, replace=False))
    stated = stated if wrong else true
    node, Q = base.truth["0"]["Q"]
    candidates = [
        one if one.node != node else replace(
            one, unit=unit(stated), bounds=None, path=(*one.path[:-1], split_unit(one.path[-1])[0])
        )
        for one in base.candidates
    ]  # fmt: skip
    values = {**base.record.values, node: raw_of(Q, true)[0]}
    record = Record(values, base.record.step_s)
    kind = f"{true}, stated {stated}"
    return replace(base, kind=kind, candidates=tuple(candidates), record=record, asks=wrong)


def unit(name: str) -> Unit:
    """Return a unit by name."""
    found = unit_of(name)
    assert found is not None  # noqa: S101 - of this file
    return found
