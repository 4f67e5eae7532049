"""Plants as integrators of other makes write them: data blocks, structures, counts, four ports.

Invented before the tables of names were read. Each is a function of a seed: names are fixed,
the machine's work is another each time. ``asks`` is set where no reader could know.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks.connect_plants import Floats, Plant, behind
from benchmarks.connect_unseen import STEP, Site

_ROWS: Final = 400  # samples of a watch
Row = tuple[str, str, str]
"""Name, role and unit of a signal."""


class Machine(Site):
    """A site whose sensors are slow, rounded and noisy, as those of a machine at work are."""

    def __init__(self, seed: int, *, still: bool = False) -> None:
        self.still = still
        super().__init__(40_000 + seed)

    def moving(self) -> dict[str, Floats]:
        """Return a valve's signals: a working cycle, a load, a droop, a meter with a lag."""
        rng, t = self.rng, np.arange(_ROWS) * STEP
        U = _cycle(rng, t) if not self.still else np.full(_ROWS, float(rng.uniform(25, 70)))
        supply = float(rng.uniform(60, 300))
        k = float(np.exp(rng.uniform(np.log(1.0), np.log(15.0))))
        opened = k * np.clip((U - rng.uniform(0, 10)) / 100, 0, None) ** rng.uniform(0.9, 1.5)
        p1 = supply * (1 - rng.uniform(0.02, 0.2) * np.clip(U, 0, 100) / 100)
        moves = 0.0 if self.still else rng.uniform(0.05, 0.3)
        load = supply * (rng.uniform(0.1, 0.5) + moves * np.sin(rng.uniform(0.5, 2) * t))
        load = np.maximum(load, 2.0)
        dp = np.maximum(p1 - load, 0.0)
        Q = behind(opened * np.sqrt(dp), float(rng.choice([0.0, 0.1, 0.3])), STEP)
        noise = rng.uniform(0.001, 0.005) * supply
        return {
            "U": U,
            "p1": np.round(p1 + rng.normal(0, noise, _ROWS), 1),
            "p2": np.round(load + rng.normal(0, noise, _ROWS), 1),
            "Q": np.round(Q + rng.normal(0, 0.008 * max(Q.max(), 1.0), _ROWS), 2),
            "T": np.round(44 + rng.uniform(-8, 8) + 0.01 * t, 1),
        }

    def means(self, path: str, role: str, values: Floats, valve: str = "V") -> None:
        """Note the true role of an existing variable."""
        node = next(o.node for o in self._candidates if o.path == tuple(path.split("|")))
        self._truth.setdefault(valve, {})[role] = node, values

    def rows(
        self, root: str, rows: tuple[tuple[str, str, str, str], ...], valve: str = "V"
    ) -> None:
        """Add (name, role, unit, text) of the true valve, without a property."""
        for name, role, unit, text in rows:
            self.add(
                f"{root}{name}", self.true[role], unit, stated=False, text=text, role=role,
                valve=valve,
            )  # fmt: skip


def one_valve(seed: int, root: str, *rows: Row, stated: bool = True) -> Machine:
    """Return a site with (name, role, unit) of its valve."""
    site = Machine(seed)
    for name, role, unit in rows:
        site.add(f"{root}{name}", site.true[role], unit, stated=stated, role=role)
    return site


def _cycle(rng: np.random.Generator, t: Floats) -> Floats:
    """Return a command: ramps between holds, or an oscillation, with dither."""
    if rng.uniform() < 0.3:
        wave = 50 + 40 * np.sin(rng.uniform(0.7, 2.0) * t) * np.cos(0.31 * t)
        return np.round(wave, 2)
    levels = rng.choice([0.0, 20.0, 35.0, 55.0, 80.0, 95.0], 40)
    held = levels[(t / rng.uniform(0.8, 2.0)).astype(int)]
    return np.round(behind(held, 0.2, STEP), 2)


def siemens_clamp(seed: int) -> Plant:
    """A data block of a clamping unit; units stand in German comments."""
    site = Machine(seed)
    root = 'CPU1517|"DB41_Spannen"."Y3".'
    site.rows(
        root,
        (
            ('"rStellwertAusgabe"', "U", "%", "Stellwert an Ventilverstärker [%]"),
            ('"rIstdruckZulauf"', "p1", "bar", "Istdruck Zulauf (P) [bar]"),
            ('"rIstdruckVerbraucher"', "p2", "bar", "Istdruck Verbraucher (A) [bar]"),
            ('"rIstmenge"', "Q", "l/min", "Ölmenge zum Verbraucher [l/min]"),
        ),
    )
    site.add(f'{root}"rSollmenge"', site.noisy(35), text="Vorgabe Ölmenge [l/min]")
    site.add(f'{root}"rIstSchieber"', site.true["U"] + site.noisy(0, 0.2), text="Schieber [%]")
    site.add(f'{root}"rDruckSteueroel"', site.noisy(60, 0.3), text="Steueröl X [bar]")
    site.add(f'{root}"rZylinderweg"', 120 + 30 * np.sin(site.t), text="Weg [mm]")
    return site.plant("Siemens, clamping unit")


def beckhoff_units_in_names(seed: int) -> Plant:
    """Members of a function block with units at the end."""
    site = Machine(seed)
    site.rows(
        "PLC1|MAIN|fbAxis[2]|",
        (
            ("lrValveOut_pct", "U", "%", ""),
            ("lrPressSup_bar", "p1", "bar", ""),
            ("lrPressLoad_bar", "p2", "bar", ""),
            ("lrFlow_lpm", "Q", "l/min", ""),
            ("lrOilTemp_degC", "T", "°C", ""),
        ),
    )
    root = "PLC1|MAIN|fbAxis[2]|"
    site.add(f"{root}lrSpoolFb_pct", site.true["U"] + site.noisy(0, 0.3))
    site.add(f"{root}lrPilot_bar", site.noisy(55, 0.2))
    site.add(f"{root}nState", site.noisy(3))
    site.add(f"{root}lrActVelo_mms", 40 * np.cos(site.t))
    return site.plant("Beckhoff, units at the names' ends")


def rockwell_psi(seed: int) -> Plant:
    """Tags of a controller, words in the comments; gauges in psi, a meter in gpm."""
    site = Machine(seed)
    site.rows(
        "Controller|Program:Hyd|",
        (
            ("FCV12_CV", "U", "%", "Prop valve FCV-12 command, pct"),
            ("PT12A_Eng", "p1", "psi", "FCV-12 upstream pressure, PSIG"),
            ("PT12B_Eng", "p2", "psi", "FCV-12 downstream pressure, PSIG"),
            ("FT12_Eng", "Q", "gpm", "FCV-12 flow, GPM"),
        ),
    )
    root = "Controller|Program:Hyd|"
    site.add(f"{root}FT12_Tot", np.cumsum(site.true["Q"]) * 0.004, text="FCV-12 total, GAL")
    site.add(f"{root}FC12_SP", site.noisy(12), text="flow set point, GPM")
    site.add(f"{root}ZT12_Eng", site.true["U"] + site.noisy(0, 0.4), text="spool position, pct")
    return site.plant("Rockwell, psi and gpm in comments")


def rexroth_ports(seed: int) -> Plant:
    """One direction used: the pressures are those of P and A."""
    site = Machine(seed)
    root = "plc|app|Application|sym|GVL_HYD|"
    for name, role, unit in (
        ("rValveCommand", "U", "%"), ("rPressureP", "p1", "bar"), ("rPressureA", "p2", "bar"),
        ("rFlowA", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    site.add(f"{root}rPressureX", site.noisy(70, 0.3), "bar")
    site.add(f"{root}rSpoolActual", site.true["U"] + site.noisy(0, 0.2), "%")
    return site.plant("Rexroth, pressures at P and A")


def french_press(seed: int) -> Plant:
    """Abbreviations in French; a totaliser and a set point beside."""
    site = Machine(seed)
    root = "Presse2|EV_Prop|"
    for name, role, unit in (
        ("Cde_EV", "U", "%"), ("P_Amont_EV", "p1", "bar"), ("P_Aval_EV", "p2", "bar"),
        ("Q_mes", "Q", "l/min"), ("Temp_huile", "T", "°C"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    site.add(f"{root}Q_cons", site.true["Q"] * 1.01, "l/min")
    site.add(f"{root}Q_cumul", np.cumsum(site.true["Q"]) * 0.001, "")
    site.add(f"{root}Recopie_tiroir", site.true["U"] + site.noisy(0, 0.2), "%")
    site.add(f"{root}Vit_pompe", site.noisy(1490, 2), "")
    return site.plant("French press, set point and totaliser")


def spanish_loop(seed: int) -> Plant:
    """Currents of 4-20 mA; the spans stand in the comments."""
    site = Machine(seed)
    root = "RTU3|AI|"
    site.add(f"{root}Mando_V5", site.true["U"], "mA", bounds=(4.0, 20.0), role="U")
    for name, role, span, text in (
        ("Presion_entrada_V5", "p1", 400.0, "4-20 mA = 0-400 bar"),
        ("Presion_salida_V5", "p2", 400.0, "4-20 mA = 0-400 bar"),
        ("Caudal_V5", "Q", 300.0, "4-20 mA = 0-300 l/min"),
    ):
        site.add(f"{root}{name}", site.true[role], "", text=text, role=role)
        site.restate(f"{root}{name}", 16.0 / span, "mA", 4.0)
    return site.plant("Spanish, 4-20 mA, spans in comments")


def italian_counts(seed: int) -> Plant:
    """Words of an analogue card; the spans stand in the comments."""
    site = Machine(seed)
    root = "PLC|Schede|AI08|"
    for name, role, span, text in (
        ("Comando_YV2", "U", 100.0, "uscita 0..27648 = 0..100 %"),
        ("Press_Monte_YV2", "p1", 400.0, "0..27648 = 0..400 bar"),
        ("Press_Valle_YV2", "p2", 250.0, "0..27648 = 0..250 bar"),
        ("Portata_YV2", "Q", 200.0, "0..27648 = 0..200 l/min"),
    ):
        counts = np.round(site.true[role] / span * 27_648)
        site.true[role] = counts * span / 27_648
        site.add(f"{root}{name}", counts, text=text, largest=32_767)
        site.means(f"{root}{name}", role, site.true[role])
    return site.plant("Italian, counts, spans in comments")


def chinese_MPa(seed: int) -> Plant:
    """No unit anywhere; pressures truly in MPa."""
    site = Machine(seed)
    root = "液压系统|1#比例阀|"
    for name, role, unit in (
        ("给定", "U", "%"), ("进油压力", "p1", "MPa"), ("出油压力", "p2", "MPa"),
        ("实际流量", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, stated=False, role=role)
    site.add(f"{root}累计流量", np.cumsum(site.true["Q"]) * 0.001)
    site.add(f"{root}先导压力", site.noisy(3.5, 0.02))
    site.add(f"{root}阀芯反馈", site.true["U"] + site.noisy(0, 0.2))
    return site.plant("Chinese, MPa without a unit", asks=True)


def four_ports(site: Site, *, leak: float = 0.01, meter_P: bool = False) -> dict[str, Floats]:
    """Return the signals of a 4/3 valve that drives a load both ways."""
    rng, t = site.rng, site.t
    U = np.round(75 * np.sin(rng.uniform(0.7, 1.8) * t) + 15 * np.sin(3.1 * t), 2)
    k = float(rng.uniform(2.5, 9.0))
    opened = np.clip(np.abs(U) - 6, 0, None) / 94
    supply = float(rng.uniform(120, 260)) - 12 * opened
    load = 35 * np.sin(rng.uniform(0.3, 0.9) * t + 1)
    pA, pB = supply / 2 + load, supply / 2 - load
    pT = np.full(len(t), 3.0)
    sides = {
        "PA": (U > 0) * k * opened**1.2 * np.sqrt(np.maximum(supply - pA, 0)),
        "AT": (U < 0) * 0.9 * k * opened * np.sqrt(np.maximum(pA - pT, 0)),
        "PB": (U < 0) * 0.8 * k * opened**1.1 * np.sqrt(np.maximum(supply - pB, 0)),
        "BT": (U > 0) * 0.7 * k * opened * np.sqrt(np.maximum(pB - pT, 0)),
    }
    across = leak * (pA - pB)
    found = {
        "U": U, "pP": supply, "pT": pT, "pA": pA, "pB": pB,
        "QA": sides["PA"] - sides["AT"] - across, "QB": sides["PB"] - sides["BT"] + across,
    }  # fmt: skip
    if meter_P:
        found["QP"] = sides["PA"] + sides["PB"]
    noise = {"U": 0.0, "pP": 0.3, "pT": 0.05, "pA": 0.3, "pB": 0.3, "QA": 0.3, "QB": 0.3, "QP": 0.3}
    return {name: own + rng.normal(0, noise[name], len(t)) for name, own in found.items()}


def servo_four_ports(seed: int) -> Plant:
    """A servo valve with both lines metered; ± 10 V; every unit stated."""
    site = Machine(seed)
    true, root = four_ports(site), "Bench|Servo 1|"
    site.add(f"{root}Command", true["U"], "±V", stated=False, bounds=(-10.0, 10.0), role="U")
    for name, role, unit in (
        ("Pressure P", "pP", "bar"), ("Pressure T", "pT", "bar"), ("Pressure A", "pA", "bar"),
        ("Pressure B", "pB", "bar"), ("Flow A", "QA", "l/min"), ("Flow B", "QB", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", true[role], unit, role=role)
    site.add(f"{root}Spool", true["U"] + site.noisy(0, 0.3), "%")
    return site.plant("4/3 servo valve, both lines metered", asks=True)


def german_four_ports(seed: int) -> Plant:
    """Formula letters with the port at the end; one line metered; U as a current of ± 40 mA."""
    site = Machine(seed)
    true, root = four_ports(site), "Walze|AGC|Servoventil|"
    site.add(f"{root}i_Soll", 0.4 * true["U"], "", bounds=(-40.0, 40.0))
    site.restate(f"{root}i_Soll", 1.0, "mA")
    site.means(f"{root}i_Soll", "U", true["U"])
    for name, role, unit in (
        ("p_P", "pP", "bar"), ("p_T", "pT", "bar"), ("p_A", "pA", "bar"), ("p_B", "pB", "bar"),
        ("Q_A", "QA", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", true[role], unit, role=role)
    site.add(f"{root}s_Kolben", 40 + 4 * np.sin(site.t), "mm")
    return site.plant("4/3 servo valve, one line metered", asks=True)


def meter_in_supply(seed: int) -> Plant:
    """A 4/3 valve whose meter sits in its supply: it counts both directions as positive."""
    site = Machine(seed)
    true, root = four_ports(site, meter_P=True), "Lift|Valve|"
    site.add(f"{root}Cmd", true["U"], "%", bounds=(-100.0, 100.0))
    for name, role, unit in (
        ("SupplyPressure", "pP", "bar"), ("TankPressure", "pT", "bar"),
        ("PressureA", "pA", "bar"), ("PressureB", "pB", "bar"), ("SupplyFlow", "QP", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", true[role], unit)
    return site.plant("4/3 valve, the meter in its supply", asks=True)


def two_chambers(seed: int) -> Plant:
    """A 4/3 valve of which only the chambers' pressures are there: no P, no T."""
    site = Machine(seed)
    true, root = four_ports(site), "Hubwerk|"
    site.add(f"{root}Ventil Stellsignal", true["U"], "%", bounds=(-100.0, 100.0))
    site.add(f"{root}Druck Kolbenseite", true["pA"], "bar")
    site.add(f"{root}Druck Stangenseite", true["pB"], "bar")
    site.add(f"{root}Durchfluss", true["QA"], "l/min")
    return site.plant("4/3 valve, chambers only", asks=True)


def dp_and_two_meters(seed: int) -> Plant:
    """A transmitter of dp; the bypass has a meter, too."""
    site = Machine(seed)
    true, root = site.true, "Skid 7|FV-77|"
    site.add(f"{root}OutputPct", true["U"], "%", role="U")
    site.add(f"{root}DiffPress", true["p1"] - true["p2"], "bar", role="dp")
    site.add(f"{root}FlowRate", true["Q"], "l/min", role="Q")
    site.add(f"{root}BypassFlow", np.maximum(90 - true["Q"], 0) + site.noisy(0, 0.3), "l/min")
    site.add(f"{root}FlowTotal", np.cumsum(true["Q"]) * 0.001, "")
    return site.plant("dp transmitter, the bypass metered, too")


def standing_still(seed: int) -> Plant:
    """Nothing moves; names and units are clear."""
    site = Machine(seed, still=True)
    for name, role, unit in (
        ("Ventilöffnung", "U", "%"), ("Vordruck", "p1", "bar"), ("Hinterdruck", "p2", "bar"),
        ("Volumenstrom Ist", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"Linie|Dosierventil|{name}", site.true[role], unit, role=role)
    site.add("Linie|Dosierventil|Volumenstrom Soll", site.noisy(30), "l/min")
    return site.plant("nothing moves, units stated")


def solenoid_current(seed: int) -> Plant:
    """The command is the solenoid's current, 0 to 800 mA, of which nothing states the range."""
    site = Machine(seed)
    true, root = site.true, "Pflug|Hubwerk|"
    site.add(f"{root}Magnetstrom Y1", 8 * true["U"], "")
    site.restate(f"{root}Magnetstrom Y1", 1.0, "mA")
    site.add(f"{root}Pumpendruck", true["p1"], "bar", role="p1")
    site.add(f"{root}Lastdruck", true["p2"], "bar", role="p2")
    site.add(f"{root}Ölstrom", true["Q"], "l/min", role="Q")
    return site.plant("solenoid current without a range", asks=True)


def arrays(seed: int) -> Plant:
    """Three valves as elements of four arrays; one supply."""
    site = Machine(seed)
    supply = site.true["p1"]
    for number in range(3):
        true, valve = (site.true if number == 0 else site.moving()), str(number)
        dp = np.maximum(supply - true["p2"], 0.0)
        p2 = np.minimum(true["p2"], supply - 5)
        dp = supply - p2
        Q = 0.06 * (1 + number) * true["U"] * np.sqrt(dp) + site.noisy(0, 0.1)
        site.add(f"HPU|ValveCmd|ValveCmd[{number}]", true["U"], "%", role="U", valve=valve)
        site.add(f"HPU|LoadPress|LoadPress[{number}]", p2, "bar", role="p2", valve=valve)
        site.add(f"HPU|Flow|Flow[{number}]", Q, "l/min", role="Q", valve=valve)
    site.add("HPU|SupplyPress", supply, "bar")
    for valve in "012":
        site.means("HPU|SupplyPress", "p1", supply, valve)
    return site.plant("three valves as elements of arrays")


def motor_speed(seed: int) -> Plant:
    """A valve that drives a motor: speed and torque beside, a flow computed from the speed."""
    site = Machine(seed)
    true, root = site.true, "Winch|PropValve|"
    for name, role, unit in (
        ("Setpoint_Valve", "U", "%"), ("PumpPressure", "p1", "bar"), ("MotorPressure", "p2", "bar"),
        ("MeasuredFlow", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", true[role], unit, role=role)
    site.add(f"{root}ActualSpeed", true["Q"] * 12, "rpm")
    site.add(f"{root}CalculatedFlow", true["Q"] * 1.03, "l/min")
    site.add(f"{root}SpeedSetpoint", true["U"] * 5, "rpm")
    return site.plant("winch, flow measured and computed")


def tenth_of_the_flow(seed: int) -> Plant:
    """The meter's factor is off by ten; no name plate is given."""
    site = Machine(seed)
    true, root = site.true, "Unit|Valve A|"
    for name, role, unit in (
        ("Command", "U", "%"), ("InletPressure", "p1", "bar"), ("OutletPressure", "p2", "bar"),
    ):  # fmt: skip
        site.add(f"{root}{name}", true[role], unit, role=role)
    site.add(f"{root}Flow", true["Q"] / 10, "l/min")
    return site.plant("flow is a tenth, no name plate", asks=True)


FOURTH: Final[dict[str, Callable[[int], Plant]]] = {
    make.__name__: make
    for make in (
        siemens_clamp, beckhoff_units_in_names, rockwell_psi, rexroth_ports, french_press,
        spanish_loop, italian_counts, chinese_MPa, servo_four_ports, german_four_ports,
        meter_in_supply, two_chambers, dp_and_two_meters, standing_still, solenoid_current, arrays,
        motor_speed, tenth_of_the_flow,
    )
}  # fmt: skip
"""Plants by name."""
