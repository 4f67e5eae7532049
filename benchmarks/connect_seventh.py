"""Plants of other languages and shapes than those before, drawn before the tables were read.

Members of structures whose meaning stands in a parent's name, statistics beside each value, counts,
shared signals, ranges left at their defaults, two meters, sensors that stand still.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks.connect_fourth import Machine, one_valve
from benchmarks.connect_plants import Plant


def polish_press(seed: int) -> Plant:
    """Names without accents; the pilot's pressure and the spool's position beside."""
    root = "Prasa|ZaworProporcjonalny|"
    site = one_valve(
        seed, root, ("Sterowanie", "U", "%"), ("CisnienieZasilania", "p1", "bar"),
        ("CisnienieOdbiornika", "p2", "bar"), ("Przeplyw", "Q", "l/min"),
        ("TemperaturaOleju", "T", "°C"),
    )  # fmt: skip
    site.add(f"{root}CisnieniePilota", site.noisy(35, 0.2), "bar")
    site.add(f"{root}PolozenieSuwaka", site.true["U"] + site.noisy(0, 0.3), "%")
    return site.plant("Polish press")


def japanese_die_casting(seed: int) -> Plant:
    """Units in brackets; the speed of injection beside."""
    root = "ダイカスト機|比例弁1|"
    site = one_valve(
        seed, root, ("指令(%)", "U", "%"), ("元圧(MPa)", "p1", "MPa"), ("負荷圧(MPa)", "p2", "MPa"),
        ("流量(L/min)", "Q", "l/min"), ("作動油温度(℃)", "T", "°C"), stated=False,
    )  # fmt: skip
    site.add(f"{root}射出速度(m/s)", 0.4 + 0.1 * np.sin(site.t))
    site.add(f"{root}スプール位置(%)", site.true["U"] + site.noisy(0, 0.2))
    return site.plant("Japanese die casting")


def korean_line(seed: int) -> Plant:
    """Units as properties; a tank's level beside."""
    root = "유압장치|비례밸브 2|"
    site = one_valve(
        seed, root, ("밸브 명령", "U", "%"), ("공급 압력", "p1", "bar"), ("부하 압력", "p2", "bar"),
        ("유량", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}탱크 레벨", site.noisy(70, 0.1), "%")
    site.add(f"{root}유량 설정값", site.true["Q"] * 0.99, "l/min")
    return site.plant("Korean line")


def czech_line(seed: int) -> Plant:
    """Before and behind the valve, in kPa."""
    root = "Linka|Ventil Y5|"
    site = one_valve(
        seed, root, ("Řízení ventilu", "U", "%"), ("Tlak před ventilem", "p1", "kPa"),
        ("Tlak za ventilem", "p2", "kPa"), ("Průtok", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Žádaná hodnota průtoku", site.true["Q"] * 1.01, "l/min")
    site.add(f"{root}Otáčky čerpadla", site.noisy(1480, 2), "rpm")
    return site.plant("Czech line, kPa")


def swedish_crane(seed: int) -> Plant:
    """Compound words; MPa."""
    root = "Kran|Lyftventil|"
    site = one_valve(
        seed, root, ("Styrsignal", "U", "%"), ("Matningstryck", "p1", "MPa"),
        ("Lasttryck", "p2", "MPa"), ("Oljeflöde", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Pilottryck", site.noisy(30, 0.1), "bar")
    site.add(f"{root}Kranvinkel", 20 + 8 * np.sin(site.t), "deg")
    return site.plant("Swedish crane")


def dutch_lock(seed: int) -> Plant:
    """Two valves, one supply pressure in the folder above."""
    site = Machine(seed)
    supply = site.true["p1"]
    for number in (1, 2):
        true = site.true if number == 1 else site.moving()
        p2 = np.minimum(true["p2"], supply - 5)
        Q = 0.05 * number * true["U"] * np.sqrt(supply - p2) + site.noisy(0, 0.1)
        root, valve = f"Sluis|Klep {number}|", str(number)
        site.add(f"{root}Stuursignaal", true["U"], "%", role="U", valve=valve)
        site.add(f"{root}Cilinderdruk", p2, "bar", role="p2", valve=valve)
        site.add(f"{root}Debiet", Q, "l/min", role="Q", valve=valve)
        site.add(f"{root}Klepstand", true["U"] + site.noisy(0, 0.3), "%")
    site.add("Sluis|Systeemdruk", supply, "bar")
    for valve in "12":
        site.means("Sluis|Systeemdruk", "p1", supply, valve)
    return site.plant("Dutch lock, two valves, one supply")


def portuguese_suffixes(seed: int) -> Plant:
    """Units at the ends of the names."""
    root = "CLP|Prensa3|"
    site = one_valve(
        seed, root, ("Comando_valvula_pct", "U", "%"), ("Pressao_montante_kPa", "p1", "kPa"),
        ("Pressao_jusante_kPa", "p2", "kPa"), ("Vazao_m3h", "Q", "m³/h"), stated=False,
    )  # fmt: skip
    site.add(f"{root}Vazao_total_m3", np.cumsum(site.true["Q"]) * 1e-5)
    site.add(f"{root}Curso_mm", 300 + 60 * np.sin(site.t))
    return site.plant("Portuguese, units at the names' ends")


def turkish_counts(seed: int) -> Plant:
    """Words of a card; the spans stand in the comments."""
    site, root = Machine(seed), "PLC|AI_Kart|"
    for name, role, span, text in (
        ("Valf_Komut", "U", 100.0, "0-4095 = 0-100 %"),
        ("Giris_Basinci", "p1", 400.0, "0-4095 = 0-400 bar"),
        ("Cikis_Basinci", "p2", 400.0, "0-4095 = 0-400 bar"),
        ("Debi", "Q", 300.0, "0-4095 = 0-300 l/min"),
    ):
        counts = np.round(site.true[role] / span * 4_095)
        site.true[role] = counts * span / 4_095
        site.add(f"{root}{name}", counts, text=text, largest=32_767)
        site.means(f"{root}{name}", role, site.true[role])
    return site.plant("Turkish, counts of 12 bit, spans in comments")


def nested_members(seed: int) -> Plant:
    """Members of a structure: what a number is stands in its parent's name."""
    root = "Machine|Hydraulics|Valve1|"
    site = one_valve(
        seed, root, ("Spool|Command", "U", "%"), ("Pressure|Inlet", "p1", "bar"),
        ("Pressure|Outlet", "p2", "bar"), ("Flow|Actual", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Spool|Actual", site.true["U"] + site.noisy(0, 0.3), "%")
    site.add(f"{root}Flow|Setpoint", site.true["Q"] * 1.01, "l/min")
    site.add(f"{root}Pressure|Pilot", site.noisy(30, 0.2), "bar")
    return site.plant("members, the meaning in the parent's name")


def value_and_quality(seed: int) -> Plant:
    """Each signal is a structure of value, quality and limits."""
    site, root = Machine(seed), "Unit2|PropValve|"
    for name, role, unit, top in (
        ("ValveCommand", "U", "%", 100.0), ("SupplyPressure", "p1", "bar", 400.0),
        ("LoadPressure", "p2", "bar", 400.0), ("FlowRate", "Q", "l/min", 400.0),
    ):  # fmt: skip
        site.add(f"{root}{name}|Value", site.true[role], unit, role=role)
        site.add(f"{root}{name}|Quality", site.noisy(192.0))
        site.add(f"{root}{name}|HighLimit", site.noisy(top), unit)
    return site.plant("structures of value, quality and limit")


def statistics(seed: int) -> Plant:
    """A historian's statistics beside each value."""
    site, root = Machine(seed), "Historian|"
    for tag, role, unit, text in (
        ("XV-401.OUT", "U", "%", "prop valve 401 output"),
        ("PT-401A.VAL", "p1", "bar", "valve 401 inlet pressure"),
        ("PT-401B.VAL", "p2", "bar", "valve 401 outlet pressure"),
        ("FT-401.VAL", "Q", "l/min", "valve 401 flow"),
    ):
        site.add(f"{root}{tag}", site.true[role], unit, text=text, role=role)
        name = tag.split(".", maxsplit=1)[0]
        for end, own in (("AVG", np.mean), ("MAX", np.max)):
            level = float(own(site.true[role]))
            site.add(f"{root}{name}.{end}", site.noisy(level), unit, text=f"{text}, {end.lower()}")
    return site.plant("statistics beside each value")


def dense_abbreviations(seed: int) -> Plant:
    """What an English integrator types."""
    root = "RTU|"
    site = one_valve(
        seed, root, ("hyd_vlv3_dmd_pc", "U", "%"), ("hyd_vlv3_us_prs_bar", "p1", "bar"),
        ("hyd_vlv3_ds_prs_bar", "p2", "bar"), ("hyd_vlv3_flw_lpm", "Q", "l/min"), stated=False,
    )  # fmt: skip
    site.add(f"{root}hyd_vlv3_fb_pc", site.true["U"] + site.noisy(0, 0.3))
    site.add(f"{root}hyd_pmp_prs_bar", site.true["p1"] + 8 + 0.03 * site.true["Q"])
    return site.plant("dense English abbreviations")


def thousandths(seed: int) -> Plant:
    """The command in thousandths, of which its range alone says so."""
    site, root = Machine(seed), "Achse|Ventil|"
    site.add(f"{root}Stellwert", 10 * site.true["U"], bounds=(0.0, 1_000.0))
    site.means(f"{root}Stellwert", "U", site.true["U"])
    for name, role, unit in (
        ("Systemdruck", "p1", "bar"), ("Lastdruck", "p2", "bar"), ("Durchfluss", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    return site.plant("command in thousandths, its range stated")


def half_of_ten_volts(seed: int) -> Plant:
    """A command of ± 10 V that is only used above zero."""
    site, root = Machine(seed), "Press|Servo|"
    site.add(f"{root}CommandVoltage", site.true["U"], "±V", stated=False, bounds=(-10.0, 10.0))
    site.means(f"{root}CommandVoltage", "U", site.true["U"])
    for name, role, unit in (
        ("Pump pressure", "p1", "bar"), ("Cylinder pressure", "p2", "bar"),
        ("Measured flow", "Q", "l/min"),
    ):  # fmt: skip
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    return site.plant("± 10 V, used above zero")


def drop_beside_inlet(seed: int) -> Plant:
    """A transmitter of Δp in mbar and the pressure before the valve."""
    site, root = Machine(seed), "Skid|PV-9|"
    site.add(f"{root}Valve output", site.true["U"], "%", role="U")
    site.add(f"{root}Pressure drop", site.true["p1"] - site.true["p2"], "mbar", role="dp")
    site.add(f"{root}Inlet pressure", site.true["p1"], "bar")
    site.add(f"{root}Volume flow", site.true["Q"], "l/min", role="Q")
    return site.plant("Δp beside the pressure before the valve")


def main_and_drain(seed: int) -> Plant:
    """A meter in the main line and one in the drain of the motor's case."""
    root = "Motor|Proportional valve|"
    site = one_valve(
        seed, root, ("Valve signal", "U", "%"), ("Pressure before valve", "p1", "bar"),
        ("Pressure after valve", "p2", "bar"), ("Main flow", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Case drain flow", 1.5 + 0.02 * site.true["Q"], "l/min")
    return site.plant("main line and case drain, both metered")


def meters_disagree(seed: int) -> Plant:
    """Two meters in one line that differ by 7 %: neither is known to be right."""
    root = "Bench|Valve|"
    site = one_valve(
        seed, root, ("Command", "U", "%"), ("Inlet pressure", "p1", "bar"),
        ("Outlet pressure", "p2", "bar"), ("Gear flow meter", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Turbine flow meter", 1.07 * site.true["Q"] + site.noisy(0, 0.2), "l/min")
    return site.plant("two meters that disagree", asks=True)


def range_of_nobody(seed: int) -> Plant:
    """The server's default range of 0 … 100 at every signal: the pressures leave it."""
    site, root = Machine(seed), "Device|Valve|"
    for name, role, unit in (
        ("Command", "U", "%"), ("InletPressure", "p1", "bar"), ("OutletPressure", "p2", "bar"),
        ("Flow", "Q", "l/min"),
    ):  # fmt: skip
        values = site.true[role] + (110.0 if role in {"p1", "p2"} else 0.0)
        site.add(f"{root}{name}", values, unit, bounds=(0.0, 100.0))
    return site.plant("a default range that the values leave", asks=True)


def stuck_outlet(seed: int) -> Plant:
    """The sensor behind the valve is broken: it says 0, while the load moves."""
    root = "Axis|Valve|"
    site = one_valve(
        seed, root, ("Command", "U", "%"), ("Inlet pressure", "p1", "bar"), ("Flow", "Q", "l/min")
    )
    site.add(f"{root}Load pressure", site.noisy(0.0), "bar")
    return site.plant("the sensor behind the valve says 0", asks=True)


def flow_unstated_beside_psi(seed: int) -> Plant:
    """Gauges in psi, a meter of which nothing says the unit: gpm in one plant, l/min in another."""
    site, root = Machine(seed), "Cell|Valve|"
    site.add(f"{root}Command", site.true["U"], "%")
    site.add(f"{root}Inlet pressure", site.true["p1"], "psi")
    site.add(f"{root}Outlet pressure", site.true["p2"], "psi")
    site.add(f"{root}Flow", site.true["Q"], "gpm" if seed % 2 else "l/min", stated=False)
    return site.plant("flow without a unit beside psi", asks=True)


def flow_unstated_beside_bar(seed: int) -> Plant:
    """Gauges in bar, a meter in gpm or m³/h of which nothing says so."""
    site, root = Machine(seed), "Zelle|Ventil|"
    site.add(f"{root}Stellwert", site.true["U"], "%")
    site.add(f"{root}Druck vor Ventil", site.true["p1"], "bar")
    site.add(f"{root}Druck nach Ventil", site.true["p2"], "bar")
    site.add(f"{root}Durchfluss", site.true["Q"], "gpm" if seed % 2 else "m³/h", stated=False)
    return site.plant("flow without a unit beside bar", asks=True)


def counts_without_spans(seed: int) -> Plant:
    """Pressures as words of a card, of which nothing states the span."""
    site, root = Machine(seed), "Station|Ventil 3|"
    site.add(f"{root}Ansteuerung", site.true["U"], "%")
    site.add(f"{root}Zulaufdruck", np.round(site.true["p1"] / 400 * 27_648), largest=32_767)
    site.add(f"{root}Lastdruck", np.round(site.true["p2"] / 250 * 27_648), largest=32_767)
    site.add(f"{root}Volumenstrom", site.true["Q"], "l/min")
    return site.plant("pressures in counts without spans", asks=True)


SEVENTH: Final[dict[str, Callable[[int], Plant]]] = {
    make.__name__: make
    for make in (
        polish_press, japanese_die_casting, korean_line, czech_line, swedish_crane, dutch_lock,
        portuguese_suffixes, turkish_counts, nested_members, value_and_quality, statistics,
        dense_abbreviations, thousandths, half_of_ten_volts, drop_beside_inlet, main_and_drain,
        meters_disagree, range_of_nobody, stuck_outlet, flow_unstated_beside_psi,
        flow_unstated_beside_bar, counts_without_spans,
    )
}  # fmt: skip
"""Plants by name."""
