"""More plants as vendors write them, invented once those of `connect_unseen` had been looked at."""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks.connect_plants import Plant
from benchmarks.connect_unseen import Site

_ROLES: Final = ("U", "p1", "p2", "Q")


def _of_names(seed: int, names: tuple[str, ...], units: tuple[str, ...]) -> Site:
    site = Site(seed)
    for name, role, unit in zip(names, _ROLES, units, strict=True):
        site.add(name, site.true[role], unit, role=role)
    return site


def twincat(seed: int) -> Plant:
    """Members of a structure in Hungarian notation, without any unit."""
    site, root = Site(seed), "PLC1|GVL_Hyd|fbValve[1]|stIn|"
    for name, role in (("fValveOut", "U"), ("fPressP", "p1"), ("fPressA", "p2"), ("fFlow", "Q")):
        site.add(f"{root}{name}", site.true[role], role=role)
    site.add(f"{root}fPosAct", 200 + 40 * np.sin(site.t))
    site.add(f"{root}fVelAct", 40 * np.cos(site.t))
    return site.plant("TwinCAT, no units", asks=True)


def letters(seed: int) -> Plant:
    """Formula letters with German suffixes; the spool's position beside."""
    site, root = Site(seed), "Regler|IAC_1|"
    for name, role, unit in (
        ("y_Soll", "U", "%"), ("p_P", "p1", "bar"), ("p_A", "p2", "bar"), ("Q_Ist", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    site.add(f"{root}s_Schieber_Ist", site.true["U"] + site.noisy(0, 0.2), "%")
    site.add(f"{root}p_Soll", site.noisy(120), "bar")
    site.add(f"{root}Q_Soll", site.true["Q"] * 1.02, "l/min")
    return site.plant("formula letters, setpoints beside")


def russian(seed: int) -> Plant:
    """A language that `connect` does not speak; units are stated."""
    site = _of_names(
        seed, ("Пресс|Управление клапаном", "Пресс|Давление до", "Пресс|Давление после",
                   "Пресс|Расход"), ("%", "bar", "bar", "l/min"),
    )  # fmt: skip
    return site.plant("Russian, units stated")


def japanese(seed: int) -> Plant:
    """A language that `connect` does not speak, with another pressure beside."""
    site = _of_names(
        seed, ("プレス|弁開度", "プレス|一次圧", "プレス|二次圧", "プレス|流量"),
        ("%", "MPa", "MPa", "l/min"),
    )  # fmt: skip
    site.add("プレス|パイロット圧", site.noisy(35, 0.2), "MPa")
    return site.plant("Japanese, units stated")


def kepware(seed: int) -> Plant:
    """Flat tags of a gateway; each valve's tags differ by their number alone."""
    site = Site(seed)
    for number, true in ((4711, site.true), (4712, site.moving())):
        for name, role, unit in (
            ("FCV_{}_OP", "U", "%"), ("PT_{}_IN", "p1", "kPa"), ("PT_{}_OUT", "p2", "kPa"),
            ("FT_{}_PV", "Q", "m³/h"), ("TT_{}_PV", "T", "°C"),
        ):  # fmt: skip
            path = f"Channel1|Device1|{name.format(number)}"
            site.add(path, true[role], unit, role=role, valve=str(number))
        site.add(f"Channel1|Device1|FIC_{number}_SP", site.noisy(2), "m³/h")
    site.add("Channel1|_System|_ScanRate", site.noisy(100))
    return site.plant("gateway, flat tags")


def fraction_in_percent(seed: int) -> Plant:
    """The command is 0 to 1; the property says %."""
    site = _of_names(
        seed, ("V|command", "V|p in", "V|p out", "V|flow"), ("", "bar", "bar", "l/min")
    )
    site.restate("V|command", 0.01, "%")
    return site.plant("U is 0-1, stated %", asks=True)


def thousands(seed: int) -> Plant:
    """Pressures in mbar of which the property says bar."""
    site = _of_names(
        seed, ("V|command", "V|p in", "V|p out", "V|flow"), ("%", "bar", "bar", "l/min")
    )
    for name in ("V|p in", "V|p out"):
        site.restate(name, 1000.0, "bar")
    return site.plant("mbar, stated bar", asks=True)


def inverted(seed: int) -> Plant:
    """A valve that fails open: 100 % is shut."""
    site = _of_names(
        seed, ("V|command", "V|p in", "V|p out", "V|flow"), ("%", "bar", "bar", "l/min")
    )
    site.restate("V|command", -1.0, "%", 100.0)
    return site.plant("100 % is shut", asks=True)


def stuck_meter(seed: int) -> Plant:
    """The meter shows its last value while the valve moves."""
    site = _of_names(
        seed, ("V|command", "V|p in", "V|p out", "V|flow"), ("%", "bar", "bar", "l/min")
    )
    site.restate("V|flow", 0.0, "l/min", 17.3)
    return site.plant("the meter is stuck", asks=True)


def three_pressures(seed: int) -> Plant:
    """Both pressures and a transmitter of their difference, in mbar."""
    site = _of_names(
        seed, ("V|Ventilöffnung", "V|Eingangsdruck", "V|Ausgangsdruck", "V|Durchfluss"),
        ("%", "bar", "bar", "l/min"),
    )  # fmt: skip
    site.add("V|Differenzdruck", site.true["p1"] - site.true["p2"], "mbar")
    return site.plant("p1, p2 and their difference")


def two_meters(seed: int) -> Plant:
    """The pump's flow beside the valve's: the pump delivers more than the valve takes."""
    site = _of_names(
        seed, ("HPU|valve command", "HPU|supply pressure", "HPU|load pressure",
                   "HPU|valve flow"), ("%", "bar", "bar", "l/min"),
    )  # fmt: skip
    site.add("HPU|pump flow", site.true["Q"] + 20 + 8 * np.sin(0.7 * site.t), "l/min")
    site.add("HPU|case drain flow", site.noisy(1.2, 0.05), "l/min")
    return site.plant("the pump's meter beside the valve's")


def pressures_in_mA(seed: int) -> Plant:
    """Pressures as currents of a loop, without the sensor's range."""
    site = _of_names(
        seed, ("V|command", "V|p in", "V|p out", "V|flow"), ("%", "bar", "bar", "l/min")
    )
    for name in ("V|p in", "V|p out"):
        site.restate(name, 16.0 / 400.0, "mA", 4.0)
    return site.plant("pressures in mA", asks=True)


def neighbour(seed: int) -> Plant:
    """The flow of each valve is wired to the other one's name."""
    site = Site(seed)
    one, other = site.true, site.moving()
    for number, true, Q in ((1, one, other["Q"]), (2, other, one["Q"])):
        for name, role, unit in (("Mando", "U", "%"), ("Presión entrada", "p1", "bar"),
                                 ("Presión salida", "p2", "bar")):  # fmt: skip
            site.add(f"Línea|V{number}|{name}", true[role], unit)
        site.add(f"Línea|V{number}|Caudal", Q, "l/min")
    return site.plant("the flows of two valves exchanged", asks=True)


SECOND: Final[dict[str, Callable[[int], Plant]]] = {
    make.__name__: make
    for make in (
        twincat, letters, russian, japanese, kepware, fraction_in_percent, thousands, inverted,
        stuck_meter, three_pressures, two_meters, pressures_in_mA, neighbour,
    )
}  # fmt: skip
"""Plants by name."""
