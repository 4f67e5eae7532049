"""More plants of other makes, invented once those of `connect_fourth` had been mended."""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks.connect_fourth import Machine, four_ports, one_valve
from benchmarks.connect_plants import Plant


def codesys_spanish(seed: int) -> Plant:
    """Members of a structure, units in their properties; set point and pilot beside."""
    root = "Application|GVL_Hidraulica|stValvula1|"
    site = one_valve(
        seed, root, ("rMando", "U", "%"), ("rPresionLineaP", "p1", "bar"),
        ("rPresionCarga", "p2", "bar"), ("rCaudalReal", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}rCaudalConsigna", site.true["Q"] * 0.98, "l/min")
    site.add(f"{root}rPresionPilotaje", site.noisy(42, 0.2), "bar")
    site.add(f"{root}rCarrera", 200 + 50 * np.sin(site.t), "mm")
    return site.plant("CODESYS, Spanish")


def french_servo(seed: int) -> Plant:
    """A tension of 0 to 10 V; the receiver's pressure."""
    root = "Banc3|Servovalve|"
    site = Machine(seed)
    site.add(f"{root}Tension de commande", site.true["U"], "V", bounds=(0.0, 10.0), role="U")
    for name, role, unit in (
        ("Pression alimentation", "p1", "bar"), ("Pression récepteur", "p2", "bar"),
        ("Débit mesuré", "Q", "l/min"), ("Température bac", "T", "°C"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    site.add(f"{root}Débit calculé", site.true["Q"] * 1.02, "l/min")
    site.add(f"{root}Vitesse moteur", site.noisy(1480, 2), "rpm")
    return site.plant("French servo valve")


def italian_skid(seed: int) -> Plant:
    """Flow in m³/h; the pump's name for the supply."""
    root = "Skid|YV7|"
    site = one_valve(
        seed, root, ("Comando [%]", "U", "%"), ("P mandata pompa [bar]", "p1", "bar"),
        ("P utenza [bar]", "p2", "bar"), ("Portata [m3/h]", "Q", "m³/h"), stated=False,
    )  # fmt: skip
    site.add(f"{root}Totalizzatore [m3]", np.cumsum(site.true["Q"]) * 1e-5)
    site.add(f"{root}Retroazione cursore [%]", site.true["U"] + site.noisy(0, 0.3))
    return site.plant("Italian skid, m³/h")


def chinese_ports(seed: int) -> Plant:
    """Pressures by the letters of their ports, units in brackets."""
    site = one_valve(
        seed, "测试台|", ("比例阀1指令(%)", "U", "%"), ("P口压力(MPa)", "p1", "MPa"),
        ("A口压力(MPa)", "p2", "MPa"), ("流量计1(L/min)", "Q", "l/min"),
        ("油温(℃)", "T", "°C"), stated=False,
    )  # fmt: skip
    site.add("测试台|泵转速(rpm)", site.noisy(1500, 2))
    site.add("测试台|控制油压力(MPa)", site.noisy(5, 0.02))
    return site.plant("Chinese, letters of ports")


def mobile_current(seed: int) -> Plant:
    """A solenoid's current whose range is stated; pressures in kPa."""
    site, root = Machine(seed), "ECU|Boom|"
    site.add(f"{root}ValveCurrent", 200 + 5 * site.true["U"], "", bounds=(200.0, 700.0))
    site.restate(f"{root}ValveCurrent", 1.0, "mA")
    site.means(f"{root}ValveCurrent", "U", site.true["U"])
    for name, role, unit in (
        ("PumpPress", "p1", "kPa"), ("LoadPress", "p2", "kPa"), ("FlowRate", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    site.add(f"{root}JoystickY", site.true["U"] / 100 + site.noisy(0, 0.02))
    site.add(f"{root}BoomAngle", 20 + 10 * np.sin(site.t), "deg")
    return site.plant("mobile machine, current with its range")


def ignition(seed: int) -> Plant:
    """Instances of a type; abbreviations."""
    root = "default|Hyd|PV1|"
    site = one_valve(
        seed, root, ("Cmd", "U", "%"), ("Press_Up", "p1", "psi"), ("Press_Dn", "p2", "psi"),
        ("Flow_PV", "Q", "gpm"),
    )  # fmt: skip
    site.add(f"{root}Flow_SP", site.true["Q"] * 1.01, "gpm")
    site.add(f"{root}Flow_Tot", np.cumsum(site.true["Q"]) * 1e-3)
    site.add(f"{root}Cmd_Max", site.noisy(100), "%")
    return site.plant("Ignition, abbreviations")


def loops(seed: int) -> Plant:
    """One loop per instrument: nothing distinguishes the pressures."""
    site = one_valve(
        seed, "DCS|", ("FIC-310.OP", "U", "%"), ("PI-311.PV", "p1", "bar"),
        ("PI-312.PV", "p2", "bar"), ("FIC-310.PV", "Q", "l/min"),
    )  # fmt: skip
    site.add("DCS|FIC-310.SP", site.noisy(30), "l/min")
    return site.plant("a loop for each instrument")


def bench(seed: int) -> Plant:
    """Letters and units, as a test bench writes them."""
    site = Machine(seed)
    site.add("Bench|U [V]", site.true["U"], "V", stated=False, bounds=(0.0, 10.0), role="U")
    for name, role, unit in (
        ("p1 [bar]", "p1", "bar"), ("p2 [bar]", "p2", "bar"), ("Q [l/min]", "Q", "l/min"),
        ("T [°C]", "T", "°C"),
    ):  # fmt: skip
        site.add(f"Bench|{name}", site.true[role], unit, stated=False, role=role)
    site.add("Bench|n [1/min]", site.noisy(1500, 2))
    site.add("Bench|M [Nm]", site.noisy(80, 3))
    site.add("Bench|p0 [bar]", site.noisy(1.0, 0.01))
    return site.plant("test bench, letters")


def german_ports(seed: int) -> Plant:
    """A 4/3 valve whose signals are named by connection; both lines metered."""
    site, root = Machine(seed), "Prüfstand|Wegeventil|"
    true = four_ports(site)
    site.add(f"{root}Stellgröße", true["U"], "%", bounds=(-100.0, 100.0), role="U")
    for port in "PTAB":
        site.add(f"{root}Druck {port}", true[f"p{port}"], "bar", role=f"p{port}")
    for line in "AB":
        site.add(f"{root}Volumenstrom {line}", true[f"Q{line}"], "l/min", role=f"Q{line}")
    site.add(f"{root}Steuerdruck X", site.noisy(60, 0.2), "bar")
    site.add(f"{root}Schieberweg", true["U"] + site.noisy(0, 0.3), "%")
    return site.plant("4/3 valve, German", asks=True)


def ports_in_MPa(seed: int) -> Plant:
    """A 4/3 valve in MPa; the flow of line A has the wrong sign."""
    site, root = Machine(seed), "Rig|DCV|"
    true = four_ports(site)
    site.add(f"{root}Command", true["U"], "%", bounds=(-100.0, 100.0))
    for port in "PTAB":
        site.add(f"{root}Pressure_{port}", true[f"p{port}"], "MPa")
    site.add(f"{root}Flow_A", -true["QA"], "l/min")
    return site.plant("4/3 valve, the meter is turned round", asks=True)


def pump_off(seed: int) -> Plant:
    """The valve is moved while the pump is off."""
    site, root = Machine(seed), "Linie 4|Ventil|"
    site.add(f"{root}Stellwert", site.true["U"], "%", role="U")
    for name, role, level, unit in (
        ("Druck vor", "p1", 1.1, "bar"), ("Druck nach", "p2", 0.9, "bar"),
        ("Durchfluss", "Q", 0.0, "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.noisy(level, 0.03), unit, role=role)
    return site.plant("the pump is off")


def kPa_said_bar(seed: int) -> Plant:
    """The property says bar, the numbers are kPa."""
    root = "Anlage|FV3|"
    site = one_valve(
        seed, root, ("Ausgang", "U", "%"), ("Druck vor FV3", "p1", "bar"),
        ("Druck nach FV3", "p2", "bar"), ("Menge", "Q", "l/min"),
    )  # fmt: skip
    for name in ("Druck vor FV3", "Druck nach FV3"):
        site.restate(f"{root}{name}", 100.0, "bar")
    return site.plant("kPa, stated bar", asks=True)


def meter_of_the_pump(seed: int) -> Plant:
    """The meter is the pump's: a bypass takes a part that changes."""
    site, root = Machine(seed), "Unit 5|"
    for name, role, unit in (
        ("Valve command", "U", "%"), ("Pressure upstream", "p1", "bar"),
        ("Pressure downstream", "p2", "bar"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit)
    top = float(site.true["Q"].max())
    site.add(f"{root}Flow", site.true["Q"] + top * (0.6 + 0.2 * np.sin(0.9 * site.t)), "l/min")
    return site.plant("the meter is the pump's", asks=True)


def feedback_only(seed: int) -> Plant:
    """No command, but the spool's position."""
    root = "Regler|HPV|"
    site = one_valve(
        seed, root, ("Zulaufdruck", "p1", "bar"), ("Lastdruck", "p2", "bar"),
        ("Volumenstrom", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Schieberposition Ist", site.true["U"] + site.noisy(0, 0.2), "%")
    return site.plant("the spool's position, no command", asks=True)


def card(seed: int) -> Plant:
    """Elements of one array: no name distinguishes the pressures, but the orifice law does."""
    site = Machine(seed)
    for name, role in (
        ("aPress[0]", "p1"),
        ("aPress[1]", "p2"),
        ("aCmd[0]", "U"),
        ("aFlow[0]", "Q"),
    ):
        unit = {"U": "%", "Q": "l/min"}.get(role, "bar")
        site.add(f"PLC|{name}", site.true[role], unit, role=role)
    site.add("PLC|aPress[2]", site.noisy(60, 0.2), "bar")
    return site.plant("three pressures of an array")


FIFTH: Final[dict[str, Callable[[int], Plant]]] = {
    make.__name__: make
    for make in (
        codesys_spanish, french_servo, italian_skid, chinese_ports, mobile_current, ignition, loops,
        bench, german_ports, ports_in_MPa, pump_off, kPa_said_bar, meter_of_the_pump, feedback_only,
        card,
    )
}  # fmt: skip
"""Plants by name."""
