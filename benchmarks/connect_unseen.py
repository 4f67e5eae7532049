"""Plants as vendors write them, for the benchmark of `connect`: none is made of its vocabulary.

Each is a function of a seed: the names are as invented here, the movement is another each time.
``asks`` is set where no reader could know: a question is the only right outcome.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.connect_plants import EXCITATIONS, Floats, Plant, raw_of, signals
from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.reading import Record

STEP: Final = 0.05  # s


class Site:
    """Collects the variables of one plant; ``true`` are a moving valve's signals, in our units."""

    def __init__(self, seed: int, excitation: str | None = None) -> None:
        self.rng = np.random.default_rng([38, seed])
        self.excitation = excitation or str(self.rng.choice(EXCITATIONS))
        self.true = self.moving()
        self.t = np.arange(len(self.true["U"])) * STEP
        self._candidates: list[Candidate] = []
        self._values: dict[str, Floats] = {}
        self._truth: dict[str, dict[str, tuple[str, Floats]]] = {}

    def moving(self) -> dict[str, Floats]:
        """Return the signals of one more valve."""
        return signals(self.rng, self.excitation, STEP)

    def noisy(self, level: float, spread: float = 0.0) -> Floats:
        """Return a steady value with noise."""
        return level + self.rng.normal(0.0, spread, len(self.t))

    def add(
        self,
        path: str,
        values: Floats,
        unit: str = "",
        *,
        stated: bool = True,
        bounds: tuple[float, float] | None = None,
        text: str = "",
        largest: float | None = None,
        role: str = "",
        valve: str = "V",
    ) -> None:
        """Add a variable with values in our unit; ``role`` is its true role at ``valve``.

        ``unit`` is the one of its numbers, in the property if ``stated``.
        """
        raw, _ = raw_of(values, unit) if unit else (values, None)
        own = unit_of(unit) if unit and stated else None
        symbol = unit if stated and own is None else ""
        node = f"n{len(self._candidates)}"
        if largest is not None:
            raw = np.round(raw)
        self._candidates.append(
            Candidate(
                node, tuple(path.split("|")), own, bounds, description=text, symbol=symbol,
                largest=largest,
            )
        )  # fmt: skip
        self._values[node] = raw
        if role:
            self._truth.setdefault(valve, {})[role] = node, values

    def restate(self, path: str, factor: float, unit: str, offset: float = 0.0) -> None:
        """Replace a variable's numbers by ``factor · number + offset``, stated in ``unit``."""
        names = tuple(path.split("|"))
        place = next(n for n, one in enumerate(self._candidates) if one.path == names)
        one = self._candidates[place]
        self._candidates[place] = replace(one, unit=unit_of(unit))
        self._values[one.node] = factor * self._values[one.node] + offset

    def plant(self, kind: str, *, asks: bool = False) -> Plant:
        """Return the plant of the collected variables."""
        order = self.rng.permutation(len(self._candidates))
        candidates = tuple(self._candidates[i] for i in order)
        return Plant(kind, candidates, Record(self._values, STEP), self._truth, asks=asks)


def german_press(seed: int) -> Plant:
    """A data block without properties; units are in the comments."""
    site = Site(seed)
    true, block = site.true, 'PLC_1|"DB_Presse"."Y1".'
    for name, role, unit, text in (
        ("Stellgroesse_Y", "U", "%", "Ausgang Regler in % auf Proportionalventil Y1"),
        ("pVorVentil", "p1", "bar", "Druck vor Proportionalventil Y1 [bar]"),
        ("pNachVentil", "p2", "bar", "Druck nach Proportionalventil Y1 [bar]"),
        ("Vol_Strom", "Q", "l/min", "Volumenstrom Zahnradmesszelle [l/min]"),
        ("Oel_Temp", "T", "°C", "Öltemperatur Tank [°C]"),
    ):
        site.add(f'{block}"{name}"', true[role], unit, stated=False, text=text, role=role)
    site.add(f'{block}"Sollwert_Extern"', site.noisy(60), text="Vorgabe Bediener [%]")
    site.add(f'{block}"Istwert_Schieber"', true["U"] + site.noisy(0, 0.3), text="Rückführung [%]")
    site.add(f'{block}"Drehzahl_P1"', site.noisy(1480, 2), text="Pumpe 1 [1/min]")
    site.add(f'{block}"pSpeicher"', true["p1"] + site.noisy(4, 0.5), text="Druckspeicher [bar]")
    site.add(f'{block}"pVorsteuer"', site.noisy(31, 0.2), text="Vorsteuerdruck [bar]")
    return site.plant("German press, units in comments")


def italian_injection(seed: int) -> Plant:
    """A machine's folder with properties; the command is in volts of ± 10 V."""
    site = Site(seed)
    true, folder = site.true, "Macchina|GruppoIdraulico|ValvolaProp1|"
    site.add(f"{folder}Comando", true["U"], "±V", stated=False, bounds=(-10.0, 10.0), role="U")
    site.add(f"{folder}P_Monte", true["p1"], "bar", bounds=(0.0, 400.0), role="p1")
    site.add(f"{folder}P_Valle", true["p2"], "bar", bounds=(0.0, 400.0), role="p2")
    site.add(f"{folder}Portata_lmin", true["Q"], "l/min", stated=False, role="Q")
    site.add(f"{folder}TempOlio", true["T"], "°C", role="T")
    site.add(f"{folder}Corsa_Vite", 120 + 40 * np.sin(site.t), "mm")
    site.add(f"{folder}Giri_Pompa", site.noisy(1450, 3))
    site.add(f"{folder}P_Pilotaggio", site.noisy(28, 0.2), "bar")
    site.add(f"{folder}Contropressione_SP", site.noisy(12), "bar")
    return site.plant("Italian injection moulding, ± 10 V")


def chinese_mill(seed: int) -> Plant:
    """A servo valve on a cylinder: the pressures of both chambers, one meter."""
    site = Site(seed)
    U = 70 * np.sin(site.rng.uniform(0.8, 2.5) * site.t) + 10 * np.sin(5 * site.t)
    pA, pB = 90 + 30 * np.sin(0.8 * site.t), 70 - 25 * np.sin(0.8 * site.t)
    supply = site.noisy(210, 0.5)
    Q = np.where(U > 0, 0.05 * U * np.sqrt(supply - pA), 0.05 * U * np.sqrt(pA - 3))
    folder = "轧机|AGC|伺服阀1|"
    site.add(f"{folder}给定电流", 0.4 * U, "mA", bounds=(-40.0, 40.0))
    site.add(f"{folder}系统压力", supply, "MPa")
    site.add(f"{folder}无杆腔压力", pA, "MPa")
    site.add(f"{folder}有杆腔压力", pB, "MPa")
    site.add(f"{folder}流量", Q, "l/min")
    site.add(f"{folder}辊缝", 12 + 0.01 * U, "mm")
    return site.plant("Chinese mill, chambers of a cylinder", asks=True)


def chinese_line(seed: int) -> Plant:
    """Units behind the names in full width; a flat list; loop numbers at the end."""
    site = Site(seed)
    true = site.true
    for name, role, unit in (
        ("比例阀控制量％_3号", "U", "%"),
        ("比例阀前压力（MPa）_3号", "p1", "MPa"),
        ("比例阀后压力（MPa）_3号", "p2", "MPa"),
        ("瞬时流量（L/min）_3号", "Q", "l/min"),
        ("液压油温度（℃）_3号", "T", "°C"),
    ):
        site.add(f"液压站|{name}", true[role], unit, stated=False, role=role)
    site.add("液压站|油缸位移（mm）_3号", 300 + 50 * np.sin(site.t))
    site.add("液压站|主泵转速（rpm）_3号", site.noisy(1485, 2))
    site.add("液压站|控制油压力（MPa）_3号", site.noisy(4, 0.02))
    return site.plant("Chinese line, units in full width")


def structure(seed: int) -> Plant:
    """A type of structure: the meaning is in the path, the last name is Value; limits beside."""
    site = Site(seed)
    true, root = site.true, "Objects|HydraulicUnit|ProportionalValve_2|"
    for place, role, unit in (
        ("Control|Command", "U", "%"),
        ("Process|InletPressure", "p1", "bar"),
        ("Process|OutletPressure", "p2", "bar"),
        ("Process|Flow", "Q", "l/min"),
        ("Process|Temperature", "T", "°C"),
    ):
        site.add(f"{root}{place}|Value", true[role], unit, role=role)
        site.add(f"{root}{place}|HighLimit", site.noisy(1.4 * float(true[role].max())), unit)
        site.add(f"{root}{place}|Quality", site.noisy(192))
    return site.plant("structures, the last name is Value")


def raw_counts(seed: int) -> Plant:
    """Words of an input card without unit or range: which sensor is behind them is unknown."""
    site = Site(seed)
    true, card = site.true, 27_648.0
    span = {"p1": 400.0, "p2": 250.0, "Q": 150.0}
    site.add("ET200|AQ_Prop_Ventil", true["U"] / 100 * card, largest=32_767, role="U")
    for name, role in (("AI_pZu", "p1"), ("AI_pAb", "p2"), ("AI_QMess", "Q")):
        site.add(f"ET200|{name}", true[role] / span[role] * card, largest=32_767, role=role)
    return site.plant("raw counts without range", asks=True)


def psi_gauges(seed: int) -> Plant:
    """American gauges, no unit anywhere but at the meter; below 420 either unit is possible."""
    site = Site(seed)
    true, folder = site.true, "HPU1|PROP VLV 4|"
    site.add(f"{folder}VLV DRIVE PCT", true["U"], "%", stated=False, role="U")
    site.add(f"{folder}PRESS IN", 0.1 * true["p1"], "psi", stated=False, role="p1")
    site.add(f"{folder}PRESS OUT", 0.1 * true["p2"], "psi", stated=False, role="p2")
    site.add(f"{folder}FLOW GPM", true["Q"], "gpm", stated=False, role="Q")
    site.add(f"{folder}PILOT PRESS", site.noisy(450, 2))
    return site.plant("gauges without unit, truly psi", asks=True)


def current_loop(seed: int) -> Plant:
    """The command in mA of a loop; flows in litres an hour; ISA tags, another valve's beside."""
    site = Site(seed)
    for loop, true in ((201, site.true), (202, site.moving())):
        unit = f"Unit2|LOOP{loop}|"
        site.add(f"{unit}FY-{loop}_OUT", true["U"], "mA", role="U", valve=str(loop))
        site.add(f"{unit}PT-{loop}A_UPSTREAM", true["p1"], "kPa", role="p1", valve=str(loop))
        site.add(f"{unit}PT-{loop}B_DOWNSTREAM", true["p2"], "kPa", role="p2", valve=str(loop))
        site.add(f"{unit}FT-{loop}_PV", true["Q"], "l/h", role="Q", valve=str(loop))
        site.add(f"{unit}FC-{loop}_SP", site.noisy(float(true["Q"].mean())), "l/h")
        site.add(f"{unit}ZT-{loop}_POS", true["U"] + site.noisy(0, 0.3), "%")
    return site.plant("command in mA, ISA tags")


def shared_pressures(seed: int) -> Plant:
    """Two valves between one supply and one return, in one flat list."""
    site = Site(seed)
    one = site.true
    supply, back = one["p1"], site.noisy(4, 0.05)
    for number in (1, 2):
        U = one["U"] if number == 1 else site.moving()["U"]
        Q = 0.04 * U * np.sqrt(supply - back) * site.rng.uniform(0.5, 2) + site.noisy(0, 0.1)
        valve = str(number)
        site.add(f"Skid|XV{number}_cmd", U, "%", role="U", valve=valve)
        site.add(f"Skid|XV{number}_flow", Q, "l/min", role="Q", valve=valve)
    for valve in ("1", "2"):
        for name, role, values in (("P_sys", "p1", supply), ("P_return", "p2", back)):
            if valve == "1":
                site.add(f"Skid|{name}", values, "bar", role=role, valve=valve)
            else:
                site._truth[valve][role] = site._truth["1"][role]  # noqa: SLF001
    return site.plant("two valves, shared pressures, flat")


def reverse_flow(seed: int) -> Plant:
    """A throttle that the load drives backwards half of the time; the meter shows the sign."""
    return _reversing(seed, signed=True)


def reverse_flow_unsigned(seed: int) -> Plant:
    """The same with a turbine that turns either way and counts up: the map cannot be learnt."""
    return _reversing(seed, signed=False)


def _reversing(seed: int, *, signed: bool) -> Plant:
    site = Site(seed)
    U = site.true["U"]
    load = 60 * np.sin(site.rng.uniform(0.8, 1.6) * site.t)
    p1, p2 = 90 + load + site.noisy(0, 0.2), 90 - load + site.noisy(0, 0.2)
    Q = 0.05 * U * np.sign(p1 - p2) * np.sqrt(np.abs(p1 - p2)) + site.noisy(0, 0.1)
    site.add("Achse|Drossel|Stellwert", U, "%", role="U")
    site.add("Achse|Drossel|Druck 1", p1, "bar", role="p1")
    site.add("Achse|Drossel|Druck 2", p2, "bar", role="p2")
    site.add("Achse|Drossel|Durchfluss", Q if signed else np.abs(Q), "l/min", role="Q")
    words = "with" if signed else "without"
    return site.plant(f"flow reverses, meter {words} sign", asks=not signed)


def pressures_exchanged(seed: int) -> Plant:
    """Every label is right but those of the two pressures."""
    site = Site(seed)
    true = site.true
    site.add("Prensa|Mando", true["U"], "%", role="U")
    site.add("Prensa|Presión entrada", true["p2"], "bar")
    site.add("Prensa|Presión salida", true["p1"], "bar")
    site.add("Prensa|Caudal", true["Q"], "l/min", role="Q")
    return site.plant("inlet and outlet exchanged", asks=True)


def at_rest(seed: int) -> Plant:
    """A shut valve, for the whole time: names of tags alone, and no property."""
    site = Site(seed)
    site.add("MTS|Servo|cmd", site.noisy(0, 0.02), role="U")
    site.add("MTS|Servo|press 1", site.noisy(207, 0.2), role="p1")
    site.add("MTS|Servo|press 2", site.noisy(3, 0.1), role="p2")
    site.add("MTS|Servo|flow", site.noisy(0.02, 0.02), role="Q")
    return site.plant("at rest, no unit", asks=True)


def at_rest_stated(seed: int) -> Plant:
    """A shut valve with clear names and units: nothing contradicts them."""
    site = Site(seed)
    site.add("Banc|Vanne|Commande", site.noisy(0, 0.02), "%", role="U")
    site.add("Banc|Vanne|Pression amont", site.noisy(207, 0.2), "bar", role="p1")
    site.add("Banc|Vanne|Pression aval", site.noisy(3, 0.1), "bar", role="p2")
    site.add("Banc|Vanne|Débit", site.noisy(0.02, 0.02), "l/min", role="Q")
    return site.plant("at rest, units stated")


def simulated(seed: int) -> Plant:
    """A simulation server: all signals are the same saw tooth."""
    site = Site(seed)
    saw = (site.t * 10) % 100
    site.add("Simulation|ValveCommand", saw, "%", role="U")
    for name in ("InletPressure", "OutletPressure"):
        site.add(f"Simulation|{name}", saw, "bar")
    site.add("Simulation|FlowRate", saw, "l/min", role="Q")
    return site.plant("simulated: one saw tooth", asks=True)


def simulated_constants(seed: int) -> Plant:
    """A simulation server: constants that a valve that is open could never have."""
    site = Site(seed)
    for name, value, unit in (
        ("ValveCommand", 50.0, "%"),
        ("InletPressure", 10.0, "bar"),
        ("OutletPressure", 100.0, "bar"),
        ("FlowRate", 25.0, "l/min"),
    ):
        site.add(f"Demo|{name}", site.noisy(value), unit)
    return site.plant("simulated: constants against the law", asks=True)


def axis_without_meter(seed: int) -> Plant:
    """A controller of motion: position, speed, chambers, and no flow."""
    site = Site(seed)
    true = site.true
    site.add("Axis1|ValveOut", true["U"] - 50, "V", bounds=(-10.0, 10.0))
    site.add("Axis1|ActPos", 300 + 80 * np.sin(site.t), text="actual position in mm")
    site.add("Axis1|ActVel", 80 * np.cos(site.t), text="actual velocity in mm/s")
    site.add("Axis1|pA", true["p1"], "bar")
    site.add("Axis1|pB", true["p2"], "bar")
    site.add("Axis1|pS", site.noisy(210, 0.5), "bar")
    return site.plant("axis without a meter", asks=True)


def flow_by_mass(seed: int) -> Plant:
    """A Coriolis meter: kilograms a minute are no volume."""
    site = Site(seed)
    true = site.true
    site.add("Testbed|Valve opening", true["U"], "%", role="U")
    site.add("Testbed|Pressure before", true["p1"], "bar", role="p1")
    site.add("Testbed|Pressure after", true["p2"], "bar", role="p2")
    site.add("Testbed|Flow", 0.87 * true["Q"], "kg/min")
    return site.plant("flow in kg/min", asks=True)


def summed_meter(seed: int) -> Plant:
    """Two valves, each with pressures, and one meter that stands in the folder of the first."""
    return _beside_a_meter(seed, own=False)


def own_meter(seed: int) -> Plant:
    """The same names, but the meter measures the first valve alone."""
    return _beside_a_meter(seed, own=True)


def _beside_a_meter(seed: int, *, own: bool) -> Plant:
    site = Site(seed)
    one, other = site.true, site.moving()
    for number, true in ((1, one), (2, other)):
        for name, role, unit in (
            ("Command", "U", "%"),
            ("P in", "p1", "bar"),
            ("P out", "p2", "bar"),
        ):
            known = role if number == 1 else ""
            site.add(f"Cell|V{number}|{name}", true[role], unit, role=known)
    site.add("Cell|V1|Flow", one["Q"] if own else one["Q"] + other["Q"], "l/min", role="Q")
    words = "of its own" if own else "of two"
    return site.plant(f"a meter {words} beside a valve without", asks=not own)


UNSEEN: Final[dict[str, Callable[[int], Plant]]] = {
    make.__name__: make
    for make in (
        german_press, italian_injection, chinese_mill, chinese_line, structure, raw_counts,
        psi_gauges, current_loop, shared_pressures, reverse_flow, reverse_flow_unsigned,
        pressures_exchanged, at_rest, at_rest_stated, simulated, simulated_constants,
        axis_without_meter, flow_by_mass, summed_meter, own_meter,
    )
}  # fmt: skip
"""Plants by name."""
