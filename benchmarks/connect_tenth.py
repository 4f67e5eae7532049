"""Plants in languages, habits of makes and shapes that no earlier set has; one table.

Drawn before the tables of names were consulted, in the form of :mod:`benchmarks.connect_ninth`.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from benchmarks.connect_fourth import Machine
from benchmarks.connect_ninth import Row, Spec, level, like, named, noted, plant_of
from benchmarks.connect_plants import Floats, Plant

_COUNTED: Final = (
    ("U", 100.0, "%"), ("p1", 400.0, "bar"), ("p2", 400.0, "bar"), ("Q", 400.0, "l/min"),
)  # fmt: skip


def _counted(most: int, form: str, *names: tuple[str, str]) -> tuple[Row, ...]:
    """Return rows of (name, what) in counts; ``form`` is how a comment states the span."""
    return tuple(
        Row(name, role, span=span, counts=float(most), text=form.format(what, most, span, unit))
        for (name, what), (role, span, unit) in zip(names, _COUNTED, strict=True)
    )


def _mean(role: str) -> Callable[[Machine], Floats]:
    return lambda site: site.noisy(float(site.true[role].mean()), 0.1)


_SPECS: Final = {
    "polish": Spec(
        "Polish press", "Prasa|Zawór proporcjonalny Y3|",
        (*named("Sterowanie zaworu", "Ciśnienie przed zaworem", "Ciśnienie za zaworem",
                "Przepływ", "Temperatura oleju"),
         Row("Skok siłownika", "", "mm", level(210, 0.4))),
    ),
    "portuguese": Spec(
        "Portuguese moulding machine", "Injetora|Válvula VP1|",
        (*named("Abertura da válvula", "Pressão a montante", "Pressão a jusante", "Vazão",
                "Temperatura do óleo"),
         Row("Vazão desejada", "", "l/min", like("Q", 1.02))),
    ),
    "japanese": Spec(
        "Japanese moulding machine", "成形機|比例弁1|",
        (*named("弁開度指令", "一次側圧力", "二次側圧力", "流量", "油温", bar="MPa"),
         Row("ポンプ回転数", "", "rpm", level(1_500, 3))),
    ),
    "finnish": Spec(
        "Finnish", "Puristin|Venttiili 3|",
        (*named("Venttiilin ohjaus", "Tulopaine", "Lähtöpaine", "Virtaus", "Öljyn lämpötila"),
         Row("Paineen asetusarvo", "", "bar", level(150))),
    ),
    "hungarian": Spec(
        "Hungarian", "Prés|Szelep 2|",
        named("Szelepnyitás", "Nyomás szelep előtt", "Nyomás szelep után", "Térfogatáram"),
    ),
    "danish": Spec(
        "Danish crane", "Kran|Ventil 1|",
        named("Ventilåbning", "Tryk før ventil", "Tryk efter ventil", "Gennemstrømning"),
    ),
    "norwegian": Spec(
        "Norwegian winch", "Vinsj|Ventil|",
        (*named("Ventilpådrag", "Trykk inn", "Trykk ut", "Strømning"),
         Row("Turtall", "", "rpm", level(990, 2))),
    ),
    "romanian": Spec(
        "Romanian", "Presă|Supapă 1|",
        named("Comandă supapă", "Presiune intrare", "Presiune ieșire", "Debit"),
    ),
    "greek": Spec(
        "Greek", "Πρέσα|Βαλβίδα 1|",
        named("Άνοιγμα βαλβίδας", "Πίεση εισόδου", "Πίεση εξόδου", "Παροχή"),
    ),
    "ukrainian": Spec(
        "Ukrainian", "Прес|Клапан 2|",
        named("Відкриття клапана", "Тиск до клапана", "Тиск після клапана", "Витрата"),
    ),
    "drive_parameters": Spec(
        "numbered parameters of a hydraulic drive", "HNC|Axis 1|",
        (*named("P-0-2910, Valve command value", "P-0-2921, Actual pressure P-side",
                "P-0-2922, Actual pressure A-side", "P-0-2930, Actual flow value"),
         Row("S-0-0051, Position feedback value", "", "mm", level(310, 0.2)),
         Row("P-0-2911, Spool actual value", "", "%", like("U", 0.99))),
    ),
    "structure_array": Spec(
        "an element of an array of structures", "Application|GVL_Hydraulik|astVentil[3]|",
        (Row("rStellwert_Proz", "U", "%", stated=False),
         Row("rP_Zulauf_bar", "p1", "bar", stated=False),
         Row("rP_Ablauf_bar", "p2", "bar", stated=False),
         Row("rQ_lmin", "Q", "l/min", stated=False),
         Row("rT_Oel_C", "T", "°C", stated=False), Row("iZustand", "", "", level(2.0))),
    ),
    "memory_words": Spec(
        "memory words of 10,000, French comments", "API|",
        _counted(10_000, "{0}, 0..{1} = 0..{2:g} {3}",
                 ("%MW100", "Commande EV1"), ("%MW101", "Pression amont EV1"),
                 ("%MW102", "Pression aval EV1"), ("%MW103", "Débit EV1")),
    ),
    "channels": Spec(
        "channels of arrays, German comments", "Klemmen|",
        noted(("ao[0]", "U", "Ansteuerung Ventil 1 [%]"), ("ai[0]", "p1", "Druck P Ventil 1 [bar]"),
              ("ai[1]", "p2", "Druck A Ventil 1 [bar]"), ("ai[2]", "Q", "Volumenstrom [l/min]"),
              ("ai[3]", "T", "Öltemperatur [°C]")),
    ),
    "copies_for_display": Spec(
        "rounded copies for a display", "Station|Valve 5|",
        (*named("Command", "Inlet pressure", "Outlet pressure", "Flow"),
         Row("HMI_Flow", "", "l/min", lambda s: np.round(s.true["Q"])),
         Row("HMI_Inlet pressure", "", "bar", lambda s: np.round(s.true["p1"]))),
    ),
    "mirrored": Spec(
        "a slow archive copy of the whole valve", "Plant|",
        (*(Row(f"Valve 1|{r.name}", r.role, r.unit) for r in
           named("Command", "Inlet pressure", "Outlet pressure", "Flow")),
         Row("Archive|Valve 1 flow average", "", "l/min", _mean("Q")),
         Row("Archive|Valve 1 inlet pressure average", "", "bar", _mean("p1"))),
    ),
    "tight_ranges": Spec(
        "the flow leaves its range", "Cell|Valve|",
        (Row("Command", "U", "%", bounds=(0.0, 100.0)),
         Row("Inlet pressure", "p1", "bar", bounds=(0.0, 400.0)),
         Row("Outlet pressure", "p2", "bar", bounds=(0.0, 400.0)),
         Row("Flow", "Q", "l/min", bounds=(0.0, 2.0))),
        asks=True,
    ),
    "swapped_pressures": Spec(
        "the labels of both pressures are swapped", "Cell|Valve|",
        (Row("Command", "U", "%"), Row("Outlet pressure", "", "bar", like("p1")),
         Row("Inlet pressure", "", "bar", like("p2")), Row("Flow", "Q", "l/min")),
        asks=True,
    ),
    "swapped_flow": Spec(
        "flow and command are swapped", "Cell|Valve|",
        (Row("Command", "", "%", like("Q")), Row("Inlet pressure", "p1", "bar"),
         Row("Outlet pressure", "p2", "bar"), Row("Flow", "", "l/min", like("U"))),
        asks=True,
    ),
    "flow_of_another": Spec(
        "the meter is another line's", "Cell|Valve|",
        (*named("Command", "Inlet pressure", "Outlet pressure", "")[:3],
         Row("Flow", "", "l/min", lambda s: 40.0 + 15.0 * np.sin(0.9 * s.t + 1.0))),
        asks=True,
    ),
    "plant_codes": Spec(
        "plant codes, German texts", "Block 10|",
        noted(("MAX10AA001.YQ50", "U", "Stellbefehl Regelventil (%)"),
              ("MAX10CP001.XQ50", "p1", "Druck vor Regelventil (bar)"),
              ("MAX10CP002.XQ50", "p2", "Druck nach Regelventil (bar)"),
              ("MAX10CF001.XQ50", "Q", "Durchfluss Regelventil (l/min)"),
              ("MAX10CT001.XQ50", "T", "Temperatur Hydrauliköl (°C)")),
    ),
    "flat_list": Spec(
        "a valve's name before each signal", "Presse|",
        tuple(Row(f"Y1_{name}", role, unit, stated=False)
              for name, role, unit in (
                  ("Stellwert_%", "U", "%"), ("pVor_bar", "p1", "bar"), ("pNach_bar", "p2", "bar"),
                  ("Durchfluss_l/min", "Q", "l/min"))),
    ),
    "totaliser": Spec(
        "a totaliser beside the meter", "Line|FCV 3|",
        (*named("Output", "Upstream pressure", "Downstream pressure", "Flow rate"),
         Row("Flow total", "", "l", lambda s: np.cumsum(s.true["Q"]) * 0.05 / 60),
         Row("Flow alarm high", "", "l/min", level(180.0))),
    ),
    "share_of_one": Spec(
        "the command as a share of one", "Rig|Valve|",
        (Row("Valve opening", "U", "1"),
         *named("", "Supply pressure", "Load pressure", "Flow")[1:]),
    ),
    "half_words": Spec(
        "15 bits with arrows", "IO|Slot 4|",
        _counted(32_767, "{0} (0-{1} => 0-{2:g} {3})",
                 ("AO_01", "Prop. valve command"), ("AI_01", "Pressure upstream valve"),
                 ("AI_02", "Pressure downstream valve"), ("AI_03", "Oil flow")),
    ),
    "registers_japanese": Spec(
        "registers with Japanese comments", "PLC|",
        noted(("D100", "U", "比例弁指令 [%]"), ("D102", "p1", "入口圧力 [bar]"),
              ("D104", "p2", "出口圧力 [bar]"), ("D106", "Q", "流量 [l/min]")),
    ),
    "abbreviations": Spec(
        "English abbreviations", "PLC|HYD|",
        (*named("VLV_CMD", "SUP_PRS", "RTN_PRS", "FLW_RT", "OIL_TMP"),
         Row("PLT_PRS", "", "bar", level(30.0, 0.2))),
    ),
    "return_meter": Spec(
        "the meter is in the return line", "Anlage|Ventil Y7|",
        (*named("Ansteuerung", "Druck Zulauf", "Druck Rücklauf", "Volumenstrom Rücklauf"),
         Row("Füllstand Tank", "", "%", level(71.0, 0.05))),
    ),
    "namespaced": Spec(
        "identifiers joined by underscores", "Hall3_Line2_",
        (Row("PropValve7_Setpoint_Percent", "U", "%", stated=False),
         Row("PropValve7_PressurePortP_Bar", "p1", "bar", stated=False),
         Row("PropValve7_PressurePortA_Bar", "p2", "bar", stated=False),
         Row("PropValve7_FlowPortA_LPerMin", "Q", "l/min", stated=False)),
    ),
    "units_in_words": Spec(
        "units written out", "Press|Valve|",
        (Row("Opening in percent", "U", "%", stated=False),
         Row("Pressure before valve in kilopascal", "p1", "kPa", stated=False),
         Row("Pressure after valve in kilopascal", "p2", "kPa", stated=False),
         Row("Flow in litres per minute", "Q", "l/min", stated=False)),
    ),
}  # fmt: skip

TENTH: Final[dict[str, Callable[[int], Plant]]] = {
    name: partial(plant_of, spec) for name, spec in _SPECS.items()
}
"""Plants by name."""
