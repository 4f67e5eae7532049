"""Plants of other habits than the seven sets before, drawn before the tables of names were read.

Designations of KKS and IEC 81346, loops of one instrument each, units in a folder, a scale in a
node beside, status words, pumps named P1 and P2, an idle circuit, reversed signs, dead bands.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks.connect_fourth import Machine, one_valve
from benchmarks.connect_plants import Floats, Plant
from benchmarks.connect_unseen import STEP

CARD: Final = 27_648.0  # counts; full scale of an input card


def kks(seed: int) -> Plant:
    """KKS: AA is a valve, CP a pressure, CF a flow, CT a temperature; units as properties."""
    root = "AS01|10MAX21|"
    site = one_valve(
        seed, root, ("10MAX21AA101 YQ01", "U", "%"), ("10MAX21CP001 XQ01", "p1", "bar"),
        ("10MAX21CP002 XQ01", "p2", "bar"), ("10MAX21CF001 XQ01", "Q", "l/min"),
        ("10MAX21CT001 XQ01", "T", "°C"),
    )  # fmt: skip
    site.add(f"{root}10MAX21AA101 XQ01", site.true["U"] + site.noisy(0, 0.3), "%")
    site.add(f"{root}10MAX21CL001 XQ01", site.noisy(62, 0.1), "%")
    return site.plant("KKS designations")


def reference_designations(seed: int) -> Plant:
    """IEC 81346: BP, BF, BT are sensors, QN a valve; the meaning stands in the descriptions."""
    site, root = Machine(seed), "Site|=G1.HQ2|"
    for name, role, unit, text in (
        ("=G1.HQ2-QN1.KF", "U", "%", "Control output to proportional valve QN1"),
        ("=G1.HQ2-BP3", "p1", "bar", "Pressure upstream QN1"),
        ("=G1.HQ2-BP4", "p2", "bar", "Pressure downstream QN1"),
        ("=G1.HQ2-BF1", "Q", "l/min", "Flow through QN1"),
        ("=G1.HQ2-BT1", "T", "°C", "Oil temperature"),
    ):
        site.add(f"{root}{name}", site.true[role], unit, text=text, role=role)
    site.add(f"{root}=G1.HQ2-BG1", site.true["U"] + site.noisy(0, 0.3), "%", text="Spool QN1")
    site.add(f"{root}=G1.HQ2-BP9", site.noisy(6, 0.02), "bar", text="Pressure cooling circuit")
    return site.plant("IEC 81346, the meaning in descriptions")


def isa_loop(seed: int) -> Plant:
    """Instruments of a loop each: only the orifice law distinguishes the pressures."""
    root = "Area7|"
    site = one_valve(
        seed, root, ("FCV-101.OUT", "U", "%"), ("PT-101.PV", "p1", "bar"),
        ("PT-102.PV", "p2", "bar"), ("FT-101.PV", "Q", "l/min"), ("TT-101.PV", "T", "°C"),
    )  # fmt: skip
    site.add(f"{root}LT-101.PV", site.noisy(55, 0.1), "%")
    site.add(f"{root}PT-150.PV", site.noisy(5.2, 0.02), "bar")
    return site.plant("ISA tags FT-101, PT-101, PT-102")


def _idle(site: Machine) -> dict[str, Floats]:
    """Return the signals of a circuit whose pump is off and whose valve is shut."""
    levels = {"U": (0.0, 0.0), "p1": (0.8, 0.02), "p2": (0.3, 0.02), "Q": (0.0, 0.01)}
    return {role: site.noisy(*level) for role, level in levels.items()}


def idle_circuit(seed: int) -> Plant:
    """A second circuit whose pump is off; names and units are clear in both."""
    site = Machine(seed)
    for number, true in ((1, site.true), (2, _idle(site))):
        root, valve = f"Machine|Circuit{number}|", str(number)
        for name, role, unit in (
            ("ValveCommand", "U", "%"), ("PressureIn", "p1", "bar"), ("PressureOut", "p2", "bar"),
            ("Flow", "Q", "l/min"),
        ):  # fmt: skip
            site.add(f"{root}{name}", true[role], unit, role=role, valve=valve)
    return site.plant("a second circuit that is idle")


def idle_tags(seed: int) -> Plant:
    """The same by tags: no name states which of the idle circuit's pressures is upstream."""
    site = Machine(seed)
    for loop, true in ((100, site.true), (200, _idle(site))):
        for tag, role, unit in (
            (f"FCV-{loop + 1}.OUT", "U", "%"), (f"PT-{loop + 1}.PV", "p1", "bar"),
            (f"PT-{loop + 2}.PV", "p2", "bar"), (f"FT-{loop + 1}.PV", "Q", "l/min"),
        ):  # fmt: skip
            site.add(f"Area7|{tag}", true[role], unit, role=role, valve=str(loop))
    return site.plant("an idle circuit by tags", asks=True)


def siemens_symbols(seed: int) -> Plant:
    """Symbols with German short forms, units at the end."""
    root = "PLC_1|DataBlocksGlobal|DB20_Hydraulik|Y12|"
    site = one_valve(
        seed, root, ("Ausg_Y_Proz", "U", "%"), ("p_Ein_bar", "p1", "bar"),
        ("p_Aus_bar", "p2", "bar"), ("Q_Ist_l_min", "Q", "l/min"), ("T_Oel_C", "T", "°C"),
        stated=False,
    )  # fmt: skip
    site.add(f"{root}p_Soll_bar", site.noisy(120))
    site.add(f"{root}Q_Soll_l_min", site.true["Q"] * 1.01)
    site.add(f"{root}Zaehler_Std", site.noisy(10_512))
    return site.plant("Siemens symbols, German short forms")


def scale_beside(seed: int) -> Plant:
    """Int32 in hundredths; the factor stands in a node beside, the unit is that of the product."""
    site, root = Machine(seed), "Controller|Valve4|"
    for name, role, unit in (
        ("Command", "U", "%"), ("InletPressure", "p1", "bar"), ("OutletPressure", "p2", "bar"),
        ("FlowRate", "Q", "l/min"),
    ):  # fmt: skip
        counts = np.round(site.true[role] * 100)
        site.true[role] = counts / 100
        site.add(f"{root}{name}|Value", counts, unit, largest=2**31 - 1)
        site.add(f"{root}{name}|Scale", site.noisy(0.01))
        site.means(f"{root}{name}|Value", role, site.true[role])
    return site.plant("Int32, a Scale node beside")


def beckhoff_channels(seed: int) -> Plant:
    """Function blocks of a card's channels: raw counts beside the scaled value."""
    site, root = Machine(seed), "PLC|GVL_IO|"
    for name, role, unit, span in (
        ("fbAO_PropValve", "U", "%", 100.0), ("fbAI_PressSupply", "p1", "bar", 400.0),
        ("fbAI_PressLoad", "p2", "bar", 400.0), ("fbAI_Flow", "Q", "l/min", 300.0),
    ):  # fmt: skip
        counts = np.round(site.true[role] / span * 32_767)
        site.add(f"{root}{name}|nRaw", counts, largest=32_767)
        site.add(f"{root}{name}|fValue", site.true[role], unit, role=role)
        site.add(f"{root}{name}|fScaleMax", site.noisy(span), unit)
    return site.plant("Beckhoff, raw and scaled beside each other")


def device_model(seed: int) -> Plant:
    """A companion specification's devices: each has one ActualValue, its own name is a tag."""
    site = Machine(seed)
    for device, role, unit in (
        ("FCV_31|PositionerControl|ManipulatedVariable", "U", "%"),
        ("PT_31A|PressureMeasurementVariable|ActualValue", "p1", "bar"),
        ("PT_31B|PressureMeasurementVariable|ActualValue", "p2", "bar"),
        ("FT_31|VolumeFlowMeasurementVariable|ActualValue", "Q", "l/min"),
        ("TT_31|TemperatureMeasurementVariable|ActualValue", "T", "°C"),
    ):
        site.add(f"DeviceSet|{device}", site.true[role], unit, role=role)
    site.add("DeviceSet|FCV_31|PositionFeedback|ActualValue", site.true["U"] + 0.2, "%")
    site.add("DeviceSet|FT_31|Totalizer|TotalizedValue", np.cumsum(site.true["Q"]) * 1e-5, "")
    return site.plant("companion specification, ActualValue")


def range_of_counts(seed: int) -> Plant:
    """The range is the card's, the unit says bar: which sensor is behind it is unknown."""
    site, root = Machine(seed), "S7|AI|"
    site.add(f"{root}Command", site.true["U"], "%", bounds=(0.0, 100.0))
    for name, role, span in (("Pressure_In", "p1", 400.0), ("Pressure_Out", "p2", 250.0)):
        counts = np.round(site.true[role] / span * CARD)
        site.add(f"{root}{name}", counts, "bar", bounds=(0.0, CARD), largest=32_767)
    site.add(f"{root}Flow", site.true["Q"], "l/min", bounds=(0.0, 500.0))
    return site.plant("counts with their range, stated bar", asks=True)


def japanese_rack(seed: int) -> Plant:
    """Other words than those of the seventh set; a totaliser and a set point beside."""
    root = "油圧ユニット|サーボ弁A|"
    site = one_valve(
        seed, root, ("バルブ開度指令", "U", "%"), ("入口圧", "p1", "MPa"), ("出口圧", "p2", "MPa"),
        ("瞬時流量", "Q", "l/min"), ("油温", "T", "°C"),
    )  # fmt: skip
    site.add(f"{root}積算流量", np.cumsum(site.true["Q"]) * 1e-3)
    site.add(f"{root}流量設定値", site.true["Q"] * 1.01, "l/min")
    site.add(f"{root}開度実績", site.true["U"] + site.noisy(0, 0.3), "%")
    return site.plant("Japanese, before and behind")


def brazilian_press(seed: int) -> Plant:
    """Whole phrases; the pump's pressure and speed beside."""
    root = "Prensa Hidráulica|Válvula proporcional VP2|"
    site = one_valve(
        seed, root, ("Abertura da válvula", "U", "%"), ("Pressão antes da válvula", "p1", "bar"),
        ("Pressão depois da válvula", "p2", "bar"), ("Vazão instantânea", "Q", "l/min"),
        ("Temperatura do óleo", "T", "°C"),
    )  # fmt: skip
    site.add(f"{root}Rotação da bomba", site.noisy(1_750, 2), "rpm")
    site.add(f"{root}Pressão da bomba", site.true["p1"] + 7 + 0.03 * site.true["Q"], "bar")
    return site.plant("Brazilian press, whole phrases")


def polish_kPa(seed: int) -> Plant:
    """Before and behind, kPa; the alarm's limits beside."""
    root = "Stanowisko|Zawór Y2|"
    site = one_valve(
        seed, root, ("Otwarcie zaworu", "U", "%"), ("Ciśnienie przed zaworem", "p1", "kPa"),
        ("Ciśnienie za zaworem", "p2", "kPa"), ("Natężenie przepływu", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Alarm ciśnienie górny", site.noisy(31_000), "kPa")
    site.add(f"{root}Zadane natężenie przepływu", site.true["Q"] * 1.01, "l/min")
    return site.plant("Polish, before and behind, kPa")


def finnish_forest(seed: int) -> Plant:
    """A language that no table may know; units as properties."""
    root = "Harvesteri|Nosto|"
    site = one_valve(
        seed, root, ("Venttiilin ohjaus", "U", "%"), ("Paine ennen venttiiliä", "p1", "bar"),
        ("Paine venttiilin jälkeen", "p2", "bar"), ("Virtaus", "Q", "l/min"),
    )  # fmt: skip
    site.add(f"{root}Moottorin kierrosluku", site.noisy(1_600, 4), "rpm")
    site.add(f"{root}Ohjauspaine", site.noisy(32, 0.2), "bar")
    return site.plant("Finnish forest machine")


def units_in_folders(seed: int) -> Plant:
    """A folder for each quantity, with the unit in its name; the signal's own name has none."""
    return one_valve(
        seed, "Station|", ("Stellgrößen [%]|Ventil 3", "U", "%"),
        ("Drücke [kPa]|vor Ventil 3", "p1", "kPa"), ("Drücke [kPa]|nach Ventil 3", "p2", "kPa"),
        ("Durchflüsse [m³/h]|Ventil 3", "Q", "m³/h"), stated=False,
    ).plant("units in the folders' names")  # fmt: skip


def status_words(seed: int) -> Plant:
    """Words of state beside each signal, and a heart beat; units stand in the descriptions."""
    site, root = Machine(seed), "RTU7|HPU|"
    for name, role, unit, text in (
        ("Valve_Out", "U", "%", "valve output, percent"),
        ("Press_Up", "p1", "bar", "upstream pressure in bar"),
        ("Press_Down", "p2", "bar", "downstream pressure in bar"),
        ("Flow", "Q", "l/min", "flow in litres per minute"),
    ):
        site.add(f"{root}{name}", site.true[role], unit, stated=False, text=text, role=role)
        word = np.where(site.noisy(0, 1) > 1.5, 33.0, 1.0)
        site.add(f"{root}{name}_StatusWord", word, text=f"{name} status bits", largest=65_535)
    site.add(f"{root}Heartbeat", np.arange(len(site.t)) % 256.0, largest=255)
    return site.plant("status words, units in descriptions")


def pumps_named_P1_P2(seed: int) -> Plant:
    """P1 and P2 are pumps: the manifold feeds the valve, the second pump stands by."""
    site = one_valve(
        seed, "HPU|", ("Manifold.Pressure", "p1", "bar"), ("Actuator.Pressure", "p2", "bar"),
        ("PropValve.Command", "U", "%"), ("PropValve.Flow", "Q", "l/min"),
    )  # fmt: skip
    site.add("HPU|P1.Pressure", site.true["p1"] + 5 + 0.04 * site.true["Q"], "bar")
    site.add("HPU|P2.Pressure", site.noisy(0.4, 0.02), "bar")
    site.add("HPU|P3.Pressure", site.noisy(0.5, 0.02), "bar")
    site.add("HPU|P1.Speed", site.noisy(1_480, 2), "rpm")
    return site.plant("pumps named P1, P2, P3")


def pressure_loss(seed: int) -> Plant:
    """A differential transmitter that is named as a loss, in kPa, and no other pressure."""
    site, root = Machine(seed), "Loop|CV-2|"
    site.add(f"{root}Opening", site.true["U"], "%", role="U")
    site.add(f"{root}PressLoss", site.true["p1"] - site.true["p2"], "kPa", role="dp")
    site.add(f"{root}VolFlow", site.true["Q"], "l/min", role="Q")
    return site.plant("Δp named as a loss, kPa")


def meter_turned_round(seed: int) -> Plant:
    """The meter of a valve that works one way is mounted against the flow."""
    site, root = Machine(seed), "Cell|Valve|"
    for name, role, unit, sign in (
        ("Command", "U", "%", 1.0), ("Inlet pressure", "p1", "bar", 1.0),
        ("Outlet pressure", "p2", "bar", 1.0), ("Flow", "Q", "l/min", -1.0),
    ):  # fmt: skip
        site.add(f"{root}{name}", sign * site.true[role], unit)
    return site.plant("the meter is turned round", asks=True)


def command_below_zero(seed: int) -> Plant:
    """The valve opens with a command of 0 … −10 V."""
    site = one_valve(
        seed, "Rig|V|", ("Inlet pressure", "p1", "bar"), ("Outlet pressure", "p2", "bar"),
        ("Flow", "Q", "l/min"),
    )  # fmt: skip
    site.add("Rig|V|Command", -site.true["U"], "±V", stated=False, bounds=(-10.0, 10.0), role="U")
    return site.plant("the valve opens below zero")


def drop_turned_round(seed: int) -> Plant:
    """The differential transmitter's hoses are exchanged: it shows p2 − p1."""
    site, root = Machine(seed), "Rig|FV-8|"
    site.add(f"{root}Output", site.true["U"], "%")
    site.add(f"{root}DeltaP", site.true["p2"] - site.true["p1"], "bar")
    site.add(f"{root}Flow", site.true["Q"], "l/min")
    return site.plant("Δp turned round", asks=True)


def _reported(values: Floats, band: float) -> Floats:
    """Return values as a server reports them that stays silent within a band."""
    found, at = np.empty_like(values), float(values[0])
    for i, value in enumerate(values):
        at = value if abs(value - at) > band else at
        found[i] = at
    return found


def dead_band(seed: int) -> Plant:
    """Reported by exception: 1 % of the range of each signal."""
    site, root = Machine(seed), "Edge|Valve 12|"
    for name, role, unit in (
        ("Setpoint output", "U", "%"), ("Supply pressure", "p1", "bar"),
        ("Load pressure", "p2", "bar"), ("Flow rate", "Q", "l/min"),
    ):  # fmt: skip
        site.true[role] = _reported(site.true[role], 0.01 * float(np.ptp(site.true[role])))
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    return site.plant("reported with a dead band")


def slow_poll(seed: int) -> Plant:
    """A gateway polls its signals one after the other, each twice a second."""
    site, root = Machine(seed), "Gateway|Slave 3|"
    every = round(0.5 / STEP)
    for number, (name, role, unit) in enumerate((
        ("Valve demand", "U", "%"), ("Pressure before valve", "p1", "bar"),
        ("Pressure after valve", "p2", "bar"), ("Flow", "Q", "l/min"),
    )):  # fmt: skip
        at = np.arange(len(site.t))
        polled = np.maximum((at - number) // every * every + number, 0)
        site.true[role] = site.true[role][polled]
        site.add(f"{root}{name}", site.true[role], unit, role=role)
    return site.plant("polled twice a second")


def per_cent_of_span(seed: int) -> Plant:
    """Everything in % of the sensor's span, which stands in the description."""
    site, root = Machine(seed), "DCS|Unit1|"
    site.add(f"{root}FCV7_OP", site.true["U"], "%", role="U", text="valve output")
    for name, role, span, unit in (
        ("PT7A_PV", "p1", 400.0, "bar"), ("PT7B_PV", "p2", 400.0, "bar"),
        ("FT7_PV", "Q", 300.0, "l/min"),
    ):  # fmt: skip
        where = {"p1": "upstream pressure", "p2": "downstream pressure", "Q": "flow"}[role]
        text = f"FCV7 {where}, 0-100 % = 0-{span:.0f} {unit}"
        site.add(f"{root}{name}", site.true[role] / span * 100, "%", text=text)
        site.means(f"{root}{name}", role, site.true[role])
    return site.plant("per cent of span, spans in descriptions")


EIGHTH: Final[dict[str, Callable[[int], Plant]]] = {
    make.__name__: make
    for make in (
        kks, reference_designations, isa_loop, idle_circuit, idle_tags, siemens_symbols,
        scale_beside, beckhoff_channels, device_model, range_of_counts, japanese_rack,
        brazilian_press, polish_kPa, finnish_forest, units_in_folders, status_words,
        pumps_named_P1_P2, pressure_loss, meter_turned_round, command_below_zero,
        drop_turned_round, dead_band, slow_poll, per_cent_of_span,
    )
}  # fmt: skip
"""Plants by name."""
