"""Plants with a second signal that could pass for the right one; invented after `connect_fifth`."""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks.connect_fourth import Machine
from benchmarks.connect_plants import Floats, Plant, behind
from benchmarks.connect_unseen import STEP

_ROLES: Final = {"U": "%", "p1": "bar", "p2": "bar", "Q": "l/min"}


def _named(seed: int, root: str, *names: str) -> Machine:
    """Return a site whose U, p1, p2 and Q are named so; "" is left out."""
    site = Machine(seed)
    for name, (role, unit) in zip(names, _ROLES.items(), strict=True):
        if name:
            site.add(f"{root}|{name}", site.true[role], unit, role=role)
    return site


def _flow(site: Machine, U: Floats) -> Floats:
    dp = np.maximum(site.true["p1"] - site.true["p2"], 0.0)
    return 0.05 * U * np.sqrt(dp) + site.noisy(0, 0.1)


def actual_beside(seed: int) -> Plant:
    """The spool's feedback is named as the command is."""
    site = _named(seed, "L1", "Ventil Soll", "Druck vor", "Druck nach", "Durchfluss")
    site.add("L1|Ventil Ist", behind(site.true["U"], 0.05, STEP) + site.noisy(0, 0.3), "%")
    return site.plant("set point and feedback of the spool")


def pump_and_supply(seed: int) -> Plant:
    """The pump's pressure beside that at the valve, a filter between them."""
    site = _named(seed, "HPU", "Valve command", "Supply pressure at valve", "Load pressure", "Flow")
    site.add("HPU|Pump pressure", site.true["p1"] + 6 + site.true["Q"] * 0.03, "bar")
    return site.plant("pressure of the pump and at the valve")


def other_branch(seed: int) -> Plant:
    """A second meter measures another actuator's branch."""
    site = _named(seed, "M", "Cmd", "P in", "P out", "Flow cylinder")
    site.add("M|Flow motor", 40 + 10 * np.sin(site.t), "l/min")
    return site.plant("a meter of another branch")


def totaliser_alone(seed: int) -> Plant:
    """The only flow is a totaliser's litres."""
    site = _named(seed, "S", "Cmd", "P in", "P out", "")
    site.add("S|Flow total", np.cumsum(site.true["Q"]) * STEP / 60 + 1_200)
    return site.plant("a totaliser and no flow", asks=True)


def relief_valve(seed: int) -> Plant:
    """A relief valve's command beside that of the valve."""
    site = _named(
        seed, "P3", "Prop valve command", "Inlet pressure", "Outlet pressure", "Flow rate"
    )
    site.add("P3|Relief valve command", 70 + 4 * np.sin(2 * site.t), "%")
    return site.plant("command of a relief valve")


def drop_in_mbar(seed: int) -> Plant:
    """A transmitter of Δp in mbar of which nothing says so."""
    site = _named(seed, "K", "Output", "", "", "Flow")
    site.add("K|DP valve", (site.true["p1"] - site.true["p2"]) * 1_000)
    return site.plant("Δp in mbar without a unit", asks=True)


def one_in_kPa(seed: int) -> Plant:
    """The pressure behind the valve in kPa without a unit."""
    site = _named(seed, "R", "Command", "Pressure in", "", "Flow")
    site.add("R|Pressure out", site.true["p2"] * 100)
    return site.plant("one pressure in kPa without a unit", asks=True)


def joystick_counts(seed: int) -> Plant:
    """The command in counts of 16 bit without a range: beyond 27,648 no other span is left."""
    site = _named(seed, "E", "", "Pump pressure", "Load pressure", "Flow")
    counts = np.round(site.true["U"] * 327.67)
    site.true["U"] = counts / 327.67
    site.add("E|Valve command", counts, largest=32_767.0)
    site.means("E|Valve command", "U", site.true["U"])
    return site.plant("command in counts without a range")


def two_loads(seed: int) -> Plant:
    """Two outlets, of which one is another valve's: it moves alike."""
    site = _named(seed, "T", "Command", "Pressure in", "", "Flow")
    site.add("T|Pressure out 1", site.true["p2"], "bar", role="p2")
    site.add("T|Pressure out 2", 0.6 * site.true["p2"] + 20 + site.noisy(0, 0.4), "bar")
    return site.plant("two outlets that move alike")


def other_valves_flow(seed: int) -> Plant:
    """Two valves move together; the meter is that of the second one, by mistake in one folder."""
    site = _named(seed, "Q", "Command", "Pressure in", "Pressure out", "")
    other = np.clip(site.true["U"] * 0.8 + 10 * np.sin(1.7 * site.t), 0, 100)
    site.add("Q|Flow", _flow(site, other), "l/min")
    return site.plant("the flow of a valve that moves alike", asks=True)


def gain_of_the_meter_drifts(seed: int) -> Plant:
    """The meter's range switches while it is watched."""
    site = _named(seed, "W", "Command", "Pressure in", "Pressure out", "")
    gain = np.where(site.t < 0.5 * site.t[-1], 1.0, 0.1)
    site.add("W|Flow", site.true["Q"] * gain, "l/min")
    return site.plant("the meter's range switches", asks=True)


def unsigned_command(seed: int) -> Plant:
    """A valve that works both ways, of which the magnitude of the command is shown."""
    site = Machine(seed)
    U = 80 * np.sin(site.rng.uniform(0.8, 1.6) * site.t)
    supply, load = site.noisy(180, 0.3), 60 + 20 * np.sin(0.7 * site.t)
    Q = 0.05 * U * np.sqrt(np.where(U > 0, supply - load, load - 2))
    site.add("V|Command", np.abs(U), "%")
    site.add("V|Pressure in", supply, "bar")
    site.add("V|Pressure out", load, "bar")
    site.add("V|Flow", np.abs(Q) + site.noisy(0, 0.1), "l/min")
    return site.plant("magnitudes of a valve that works both ways", asks=True)


SIXTH: Final[dict[str, Callable[[int], Plant]]] = {
    make.__name__: make
    for make in (
        actual_beside, pump_and_supply, other_branch, totaliser_alone, relief_valve, drop_in_mbar,
        one_in_kPa, joystick_counts, two_loads, other_valves_flow, gain_of_the_meter_drifts,
        unsigned_command,
    )
}  # fmt: skip
"""Plants by name."""
