"""Plants of further makes and languages, drawn before the tables of names were read; one table.

Each row of a plant is a name, its values, and its unit: the role of a true signal, or how its
values follow from the site. Columns that are usual have their defaults in :class:`Row`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from benchmarks.connect_fourth import Machine
from benchmarks.connect_plants import Floats, Plant


@dataclass(frozen=True)
class Row:
    """One variable of a plant; ``role`` is its true role, ``shown`` its values if they differ.

    ``span`` makes counts of ``counts``, or 20 mA, for that many of our unit; ``stated``: the unit
    is a property.
    """

    name: str
    role: str = ""
    unit: str = ""
    shown: Callable[[Machine], Floats] | None = None
    text: str = ""
    stated: bool = True
    bounds: tuple[float, float] | None = None
    span: float = 0.0
    counts: float = 27_648.0
    valve: str = "V"


@dataclass(frozen=True)
class Spec:
    """One plant; ``asks`` where no reader could know."""

    title: str
    root: str
    rows: tuple[Row, ...]
    asks: bool = False


def plant_of(spec: Spec, seed: int) -> Plant:
    """Return the plant of a row of the table, at work as the seed has it."""
    site = Machine(seed)
    for row in spec.rows:
        path = f"{spec.root}{row.name}"
        values = site.true[row.role] if row.shown is None else row.shown(site)
        if row.unit == "mA":
            site.add(path, 100 * values / row.span, row.unit, text=row.text)
            site.means(path, row.role, values, row.valve)
            continue
        if row.span:
            counts = np.round(values / row.span * row.counts)
            largest = 32_767.0 if row.counts < 2**15 else 65_535.0
            unit = row.unit if row.stated else ""
            site.add(path, counts, unit, text=row.text, bounds=row.bounds, largest=largest)
            if row.role:
                site.means(path, row.role, counts / row.counts * row.span, row.valve)
            continue
        site.add(
            path, values, row.unit, stated=row.stated, text=row.text, bounds=row.bounds,
            role=row.role, valve=row.valve,
        )  # fmt: skip
    return site.plant(spec.title, asks=spec.asks)


def level(level: float, spread: float = 0.0) -> Callable[[Machine], Floats]:
    return lambda site: site.noisy(level, spread)


def like(role: str, factor: float = 1.0, offset: float = 0.0) -> Callable[[Machine], Floats]:
    return lambda site: factor * site.true[role] + offset


def named(U: str, p1: str, p2: str, Q: str, T: str = "", bar: str = "bar") -> tuple[Row, ...]:
    """Return a valve's rows with the usual units as properties."""
    rows = Row(U, "U", "%"), Row(p1, "p1", bar), Row(p2, "p2", bar), Row(Q, "Q", "l/min")
    return (*rows, Row(T, "T", "°C")) if T else rows


def noted(*rows: tuple[str, str, str]) -> tuple[Row, ...]:
    """Return rows of (name, role, text), whose units stand in the text or nowhere."""
    unit = {"U": "%", "p1": "bar", "p2": "bar", "Q": "l/min", "T": "°C"}
    return tuple(Row(name, role, unit[role], text=text, stated=False) for name, role, text in rows)


_SPECS: Final = {
    "spanish_mill": Spec(
        "Spanish rolling mill", "Laminador|Válvula V3|",
        (*named("Apertura válvula", "Presión antes", "Presión después", "Caudal"),
         Row("Consigna de presión", "", "bar", level(140)),
         Row("Nivel depósito", "", "%", level(61, 0.1))),
    ),
    "french_bench": Spec(
        "French bench", "Banc|Distributeur D2|",
        (*named("Ouverture", "P amont", "P aval", "Débit", "Température huile"),
         Row("Débit demandé", "", "l/min", like("Q", 1.03)),
         Row("Course vérin", "", "mm", level(120, 0.5))),
    ),
    "italian_press": Spec(
        "Italian press", "Pressa|Valvola EV4|",
        (*named("Apertura valvola", "Pressione a monte", "Pressione a valle",
                 "Portata istantanea"),
         Row("Portata richiesta", "", "l/min", like("Q", 0.97)),
         Row("Velocità pompa", "", "rpm", level(1_480, 2))),
    ),
    "addresses_french": Spec(
        "S7 addresses, French comments", "S7|DB12|",
        noted(("DB12.DBD0", "U", "Consigne distributeur Y5 (%)"),
               ("DB12.DBD4", "p1", "Pression amont Y5 (bar)"),
               ("DB12.DBD8", "p2", "Pression aval Y5 (bar)"),
               ("DB12.DBD12", "Q", "Débit Y5 (l/min)"),
               ("DB12.DBD16", "T", "Température huile (°C)")),
    ),
    "words_with_ranges": Spec(
        "counts, ranges of the sensors as properties", "S7|Rack|",
        (Row("Valve command", "U", "%", span=100.0, bounds=(0.0, 100.0)),
         Row("Inlet pressure", "p1", "bar", span=400.0, bounds=(0.0, 400.0)),
         Row("Outlet pressure", "p2", "bar", span=400.0, bounds=(0.0, 400.0)),
         Row("Flow", "Q", "l/min", span=300.0, bounds=(0.0, 300.0))),
        asks=True,
    ),
    "wrong_ranges": Spec(
        "ranges that the values leave", "Máquina|Válvula|",
        (Row("Mando", "U", "%", bounds=(0.0, 100.0)),
         Row("Presión de entrada", "p1", "bar", bounds=(0.0, 10.0)),
         Row("Presión de salida", "p2", "bar", bounds=(0.0, 10.0)),
         Row("Caudal", "Q", "l/min", bounds=(0.0, 500.0))),
        asks=True,
    ),
    "no_units": Spec(
        "no units", "Plant|FCV|",
        noted(("Command", "U", ""), ("Inlet pressure", "p1", ""), ("Outlet pressure", "p2", ""),
               ("Flow", "Q", "")),
        asks=True,
    ),
    "wrong_sign": Spec(
        "U is stated in % and works below zero", "Cella|EV1|",
        (Row("Comando", "U", "%", like("U", -1.0)), *named("", "Pressione ingresso",
         "Pressione uscita", "Portata")[1:]),
    ),
    "pump_is_inlet": Spec(
        "the pump's gauge is the inlet's", "Grupo|Bomba y válvula|",
        named("Señal válvula proporcional", "Presión bomba", "Presión cilindro", "Caudal bomba"),
    ),
    "one_still": Spec(
        "a second valve stands still", "Ligne|",
        (*(Row(f"Vanne 1|{r.name}", r.role, r.unit) for r in
           named("Commande", "Pression entrée", "Pression sortie", "Débit")),
         Row("Vanne 2|Commande", "U", "%", level(0.0), valve="W"),
         Row("Vanne 2|Pression entrée", "p1", "bar", like("p1", 1.0, 2.0), valve="W"),
         Row("Vanne 2|Pression sortie", "p2", "bar", level(9.0, 0.1), valve="W"),
         Row("Vanne 2|Débit", "Q", "l/min", level(0.0, 0.05), valve="W")),
    ),
    "turkish": Spec(
        "Turkish", "Pres|Valf 1|",
        named("Valf açıklığı", "Giriş basıncı", "Çıkış basıncı", "Debi", "Yağ sıcaklığı"),
    ),
    "czech": Spec(
        "Czech", "Lis|Ventil Y1|",
        named("Otevření ventilu", "Tlak před ventilem", "Tlak za ventilem", "Průtok"),
    ),
    "dutch_lock": Spec(
        "Dutch lock gate", "Sluis|Klep 4|",
        (*named("Klepopening", "Druk voor klep", "Druk na klep", "Debiet", "Olietemperatuur"),
         Row("Toerental pomp", "", "rpm", level(1_450, 3))),
    ),
    "swedish": Spec(
        "Swedish", "Kran|Ventil|",
        named("Ventilöppning", "Tryck före ventil", "Tryck efter ventil", "Flöde"),
    ),
    "korean": Spec(
        "Korean", "프레스|밸브1|", named("밸브 개도", "입구 압력", "출구 압력", "유량"),
    ),
    "russian": Spec(
        "Russian", "Пресс|Клапан 1|",
        named("Открытие клапана", "Давление до клапана", "Давление после клапана", "Расход"),
    ),
    "short_tags": Spec(
        "short tags, units at the end", "PLC|",
        (Row("V12_CMD_PCT", "U", "%", stated=False), Row("V12_PIN_BAR", "p1", "bar", stated=False),
         Row("V12_POUT_BAR", "p2", "bar", stated=False),
         Row("V12_FLW_LPM", "Q", "l/min", stated=False), Row("V12_ALM", "", "", level(0.0))),
    ),
    "marine": Spec(
        "marine winch", "HPU.PRV12|",
        (*named("Demand", "Press.Ups", "Press.Dns", "Flow"),
         Row("Press.Pilot", "", "bar", level(28, 0.2)), Row("Pos.Fbk", "", "%", like("U", 1.01))),
    ),
    "implement_bus": Spec(
        "implement bus, kPa", "Tractor|Auxiliary valve 1|",
        (*named("Extend command", "Pump outlet pressure", "Extend port pressure", "Flow rate",
                 bar="kPa"), Row("Engine speed", "", "rpm", level(1_900, 5))),
    ),
    "redundant": Spec(
        "two inlet gauges", "Test|Valve|",
        (*named("Command", "Inlet pressure 1", "Outlet pressure", "Flow"),
         Row("Inlet pressure 2", "", "bar", lambda s: s.true["p1"] + s.noisy(0.3, 0.1))),
    ),
    "mass_flow": Spec(
        "a meter of mass", "Test|Valve|",
        (*named("Command", "Inlet pressure", "Outlet pressure", "")[:3],
         Row("Flow", "", "kg/min", like("Q", 0.86))),
        asks=True,
    ),
    "sensor_objects": Spec(
        "an object for each sensor", "Cell|",
        (Row("Valve|Command|Value", "U", "%"), Row("Upstream|Pressure|Value", "p1", "bar"),
         Row("Downstream|Pressure|Value", "p2", "bar"), Row("Flowmeter|Flow|Value", "Q", "l/min")),
    ),
    "spans_of_loops": Spec(
        "mA, spans in the descriptions", "Skid|V1|",
        (Row("Output", "U", "%", text="valve output"),
         *(Row(name, role, "mA", text=f"{what}, 4-20 mA = 0-{span:g} {unit}", span=span)
           for name, role, span, unit, what in (
               ("PT1", "p1", 400.0, "bar", "inlet pressure"),
               ("PT2", "p2", 400.0, "bar", "outlet pressure"), ("FT1", "Q", 300.0, "l/min", "flow"))
           )),
    ),
    "si_units": Spec(
        "Pa and m³/s", "Lab|Valve|",
        (Row("Opening", "U", "%"), Row("Upstream pressure", "p1", "Pa"),
         Row("Downstream pressure", "p2", "Pa"), Row("Volume flow", "Q", "m³/s")),
    ),
    "twelve_bits": Spec(
        "12 bits, spans in the comments", "Gateway|V|",
        tuple(Row(name, role, span=span, counts=4_095.0,
                  text=f"{what}, 0..4095 = 0..{span:g} {unit}")
              for name, role, span, unit, what in (
                  ("AO1", "U", 100.0, "%", "valve command"),
                  ("AI1", "p1", 400.0, "bar", "inlet pressure"),
                  ("AI2", "p2", 250.0, "bar", "outlet pressure"),
                  ("AI3", "Q", 300.0, "l/min", "flow"))),
    ),
    "us_skid": Spec(
        "psi and gpm", "Skid 3|PropValve|",
        (Row("Valve Output", "U", "%"), Row("Supply Press", "p1", "psi"),
         Row("Load Press", "p2", "psi"), Row("Flow", "Q", "gpm"), Row("Oil Temp", "T", "°F")),
    ),
    "loss_french": Spec(
        "Δp in French", "Essai|Servovalve|",
        (Row("Commande", "U", "%"), Row("Perte de charge", "dp", "bar",
         lambda s: s.true["p1"] - s.true["p2"]), Row("Débit", "Q", "l/min")),
    ),
    "two_temperatures": Spec(
        "the tank's temperature beside the valve's", "Planta|Válvula|",
        (*named("Mando", "Presión entrada", "Presión salida", "Caudal", "Temperatura aceite"),
         Row("Temperatura motor", "", "°C", level(71, 0.2))),
    ),
    "set_and_actual": Spec(
        "set and actual values of each loop", "Line|HV7|",
        (*named("Out", "P1.Act", "P2.Act", "Q.Act"), Row("P1.Set", "", "bar", level(150)),
         Row("Q.Set", "", "l/min", like("Q", 1.02)), Row("Out.Fbk", "", "%", like("U", 0.99))),
    ),
}  # fmt: skip

NINTH: Final[dict[str, Callable[[int], Plant]]] = {
    name: partial(plant_of, spec) for name, spec in _SPECS.items()
}
"""Plants by name."""
