"""Plants on which names alone went wrong: each is read rightly, or asked; none errs in silence."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.app.sheet import rows
from valvemap.errors import ConfigurationError
from valvemap.plant.answers import of_valve, parse_answers
from valvemap.plant.reading import Given
from valvemap.plant.roles import Role


def nodes(verdict):
    return {str(role): one.path[-1] for role, one in verdict.reading.nodes.items()}


def seen(verdict, role):
    return float(np.nanmax(verdict.reading.values[Role(role)]))


def obey(plant, verdict, option):
    """The verdict on the same valve after one option's answers."""
    signals = [a.removeprefix("--signal=") for a in option.answers if a.startswith("--signal=")]
    scales = [a.removeprefix("--scale=") for a in option.answers if a.startswith("--scale=")]
    given = parse_answers(signals, scales)
    again = plant.verdicts({verdict.valve: of_valve(given, verdict.valve)})
    return next(v for v in again if v.valve == verdict.valve)


def test_units_in_chinese_names_are_read(plant, moving):
    true = moving()
    plant.add("阀门开度%", true["U"])
    plant.add("阀前压力MPa", true["p1"] / 10)
    plant.add("阀后压力MPa", true["p2"] / 10)
    plant.add("流量m3/h", true["Q"] * 0.06)
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert seen(verdict, "p1") == pytest.approx(true["p1"].max())
    assert seen(verdict, "Q") == pytest.approx(true["Q"].max())


def servo_valve(plant, true, *, exchanged=False):
    """A valve with four ports that works both ways, with a meter in each line."""
    U = 80 * np.sin(1.3 * true["t"]) + 10 * np.sin(3 * true["t"])
    pP, pT = true["p1"], 3 + 0 * U
    pA, pB = 60 + 20 * np.sin(0.8 * true["t"]), 50 - 20 * np.sin(0.8 * true["t"])
    a, b = 0.05 * np.abs(U), 0.045 * np.abs(U)
    QA = np.where(U > 0, a * np.sqrt(pP - pA), -a * np.sqrt(pA - pT))
    QB = np.where(U < 0, b * np.sqrt(pP - pB), -b * np.sqrt(pB - pT))
    if exchanged:
        QA, QB = QB, QA
    plant.add("Command", U / 10, "V", (-10.0, 10.0))
    for name, values in (("pP", pP), ("pT", pT), ("pA", pA), ("pB", pB)):
        plant.add(name, values, "bar")
    plant.add("QA", QA, "l/min")
    plant.add("QB", QB, "l/min")
    return U


def test_ports_that_no_name_tells_are_answered_by_node(plant, moving):
    servo_valve(plant, moving())
    odd = {"pP": "B21", "pT": "B24", "pA": "B22", "pB": "B23", "QA": "F31", "QB": "F32"}
    plant.candidates = [
        replace(one, path=("Plant", odd.get(one.path[-1], one.path[-1])))
        for one in plant.candidates
    ]
    (asked,) = plant.verdicts({"Plant": Given(ports=True)})
    assert "--signal=Plant.pA=NODE" in asked.question.about
    answers = [f"Plant.{name}=s=Plant/{name}" for name in odd]
    (whole,) = plant.verdicts(parse_answers(answers, (), ports=True))
    assert whole.question is None
    assert whole.has_ports
    with pytest.raises(ConfigurationError, match=r"with SIGNAL one of U, p1, p2, Q, T, dp$"):
        parse_answers(answers, ())


def test_a_servo_valve_of_four_ports_is_asked_for_its_edges_and_an_answer_is_obeyed(plant, moving):
    U = servo_valve(plant, moving())
    (verdict,) = plant.verdicts()
    assert "four ports" in verdict.question.about
    every, first, second = verdict.question.options
    assert every.answers == ("--ports=Plant",)
    assert "100 % of the flow of BT" in every.consequence
    (whole,) = plant.verdicts({"Plant": Given(ports=True)})
    assert whole.question is None
    assert whole.has_ports
    edges = {row.signal: row.reason for row in rows([whole]) if row.signal.startswith("edge")}
    assert list(edges) == ["edge PA", "edge AT", "edge PB", "edge BT"]
    assert edges["edge BT"] == "the orifice law explains 100 % of QB while BT is open"
    assert nodes(whole) == {
        "U": "Command", "p1": "pP", "p2": "pT", "pA": "pA", "pB": "pB", "Q": "QA", "QB": "QB",
    }  # fmt: skip
    assert "100 %" in first.consequence
    edge = obey(plant, verdict, first)
    assert edge.question is None
    assert nodes(edge) == {"U": "Command", "p1": "pP", "p2": "pA", "Q": "QA"}
    assert edge.least_U == 0.0
    other = obey(plant, verdict, second)
    assert nodes(other) == {"U": "Command", "p1": "pP", "p2": "pB", "Q": "QB"}
    assert np.nanmax(other.reading.values[Role.U]) == pytest.approx(-U.min())


def test_a_sheet_without_a_name_plate_says_what_to_compare_with_it(plant, moving):
    signals = moving()
    for name, values, unit in (
        ("Command", signals["U"], "%"), ("p in", signals["p1"], "bar"),
        ("p out", signals["p2"], "bar"), ("Flow", signals["Q"], "l/min"),
    ):  # fmt: skip
        plant.add(name, values, unit=unit)
    (bare,) = plant.verdicts()
    (said,) = (row.reason for row in rows([bare]) if row.signal == "Q")
    assert "its factor is not checked: compare " in said
    assert "at 35 bar and U = " in said
    one = {"p1": "Command", "p2": "p out", "U": "Command", "Q": "Flow"}
    twice = Given({Role(signal): f"s=Plant/{name}" for signal, name in one.items()})
    (refused,) = plant.verdicts({"Plant": twice})
    assert refused.question.about == "no reading of its signals fits"


def test_a_valve_that_stands_still_has_no_flow_to_compare_with_its_name_plate(plant, moving):
    true = moving()
    noise = np.random.default_rng(1).normal(0, 0.4, len(true["t"]))
    for name, values, unit in (
        ("Command", 0 * true["U"], "%"), ("p in", true["p1"], "bar"),
        ("p out", true["p2"], "bar"), ("Flow", noise, "l/min"),
    ):  # fmt: skip
        plant.add(name, values, unit=unit)
    (still,) = plant.verdicts()
    assert still.question is None
    (said,) = (row.reason for row in rows([still]) if row.signal == "Q")
    assert "Q did not move" in said
    assert "name plate" not in said


def test_what_could_take_the_place_of_a_missing_signal_is_an_option(plant, moving):
    signals = moving()
    plant.add("Spool position", signals["U"], unit="%")
    plant.add("Cylinder position", 10 * signals["t"], symbol="mm")
    for name, values, unit in (
        ("p in", signals["p1"], "bar"), ("p out", signals["p2"], "bar"),
        ("Flow", signals["Q"], "l/min"),
    ):  # fmt: skip
        plant.add(name, values, unit=unit)
    (verdict,) = plant.verdicts()
    assert "U: no node was found" in verdict.question.about
    (option,) = verdict.question.options
    assert "100 % of Q" in option.consequence
    assert nodes(obey(plant, verdict, option))["U"] == "Spool position"


def test_meters_of_exchanged_lines_are_not_learnt_as_edges(plant, moving):
    servo_valve(plant, moving(), exchanged=True)
    (verdict,) = plant.verdicts()
    assert "QA flows against the pressures while PA is open" in verdict.question.about
    assert ("--ports=Plant",) not in [option.answers for option in verdict.question.options]
    (insisted,) = plant.verdicts({"Plant": Given(ports=True)})
    assert insisted.question is not None


def test_counts_of_an_integer_are_not_taken_for_bar(plant, moving):
    true = moving()
    plant.add("Stellwert", np.round(276.48 * true["U"]), largest=32_767)
    plant.add("Druck vor Ventil", np.round(true["p1"] / 250 * 27_648), largest=32_767)
    plant.add("Druck nach Ventil", np.round(true["p2"] / 250 * 27_648), largest=32_767)
    plant.add("Durchfluss", np.round(true["Q"] / 100 * 27_648), largest=32_767)
    (verdict,) = plant.verdicts()
    assert verdict.question is not None
    wanted = {"--scale=Plant.p1=0..27648:0..250bar", "--scale=Plant.Q=0..27648:0..100l/min"}
    right = [o for o in verdict.question.options if wanted <= set(o.answers)]
    assert right, [o.answers for o in verdict.question.options]
    settled = obey(plant, verdict, right[0])
    assert settled.question is None
    assert seen(settled, "p1") == pytest.approx(true["p1"].max(), rel=1e-3)


def test_counts_with_their_range_in_the_property_need_no_question_but_the_raw_end(plant, moving):
    true = moving()
    plant.add("Stellwert", np.round(276.48 * true["U"]), "%", (0.0, 100.0), largest=32_767)
    for name, role in (("Druck vor Ventil", "p1"), ("Druck nach Ventil", "p2")):
        counts = np.round(true[role] / 250 * 27_648)
        plant.add(name, counts, "bar", (0.0, 250.0), largest=32_767)
    plant.add(
        "Durchfluss", np.round(true["Q"] / 100 * 27_648), "l/min", (0.0, 100.0), largest=32_767
    )
    (verdict,) = plant.verdicts()
    assert verdict.question is not None
    assert "0..27648:0..250bar" in verdict.question.options[0].text


def test_two_valves_share_one_supply_pressure_and_one_temperature(plant, moving):
    one, other = moving(1), moving(2)
    supply = one["p1"]
    for valve, true in (("V1", one), ("V2", other)):
        Q = 3 * true["U"] / 100 * np.sqrt(supply - true["p2"])
        plant.add(("Press", valve, "Stellsignal"), true["U"], "%")
        plant.add(("Press", valve, "Druck nach Ventil"), true["p2"], "bar")
        plant.add(("Press", valve, "Durchfluss"), Q, "l/min")
    plant.add(("Press", "Versorgungsdruck"), supply, "bar")
    plant.add(("Press", "Öltemperatur"), one["T"], "°C")
    verdicts = plant.verdicts()
    assert [v.valve for v in verdicts] == ["V1", "V2"]
    for verdict in verdicts:
        assert verdict.question is None
        assert nodes(verdict)["p1"] == "Versorgungsdruck"
        assert nodes(verdict)["T"] == "Öltemperatur"


def test_a_transmitter_of_the_pressure_drop_is_enough(plant, moving):
    true = moving()
    plant.add("Valve command", true["U"], "%")
    plant.add("dp", true["p1"] - true["p2"], "bar")
    plant.add("Flow", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert nodes(verdict) == {"U": "Valve command", "dp": "dp", "Q": "Flow"}


def test_a_cylinder_without_a_meter_is_no_valve_and_its_position_is_no_command(plant, moving):
    true = moving()
    plant.add("Zylinderweg", 300 + true["U"], symbol="mm")
    plant.add("Druck A", true["p1"], "bar")
    plant.add("Druck B", true["p2"], "bar")
    plant.add("Geschwindigkeit", true["Q"], symbol="mm/s")
    verdicts = plant.verdicts()
    assert all(v.question is not None and "no node was found" in v.question.about for v in verdicts)


def test_spool_position_pilot_pressure_and_speed_are_recognised_and_left_out(plant, moving):
    true = moving()
    plant.add("Ventilansteuerung", true["U"], "%", (-100.0, 100.0))
    plant.add("Schieberposition Ist", true["U"] + 0.1, "%", (-100.0, 100.0))
    plant.add("Steuerdruck", 30 + 0 * true["U"], "bar")
    plant.add("Druck P", true["p1"], "bar")
    plant.add("Druck A", true["p2"], "bar")
    plant.add("Drehzahl Pumpe", 1_480 + 0 * true["U"], symbol="1/min")
    plant.add("Volumenstrom", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert nodes(verdict) == {
        "U": "Ventilansteuerung", "p1": "Druck P", "p2": "Druck A", "Q": "Volumenstrom",
    }  # fmt: skip
    assert {Role.SPOOL, Role.PILOT, Role.SPEED} <= set(verdict.others.values())


def test_a_spool_position_alone_is_asked(plant, moving):
    true = moving()
    plant.add("spool position", true["U"], "%")
    plant.add("p1", true["p1"], "bar")
    plant.add("p2", true["p2"], "bar")
    plant.add("flow", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert "U: no node was found" in verdict.question.about
    assert "spool position" in verdict.question.about


@pytest.mark.parametrize("pair", [("p1", "p2"), ("U", "p1"), ("p2", "Q"), ("p1", "Q")])
def test_swapped_signals_are_asked(plant, moving, pair):
    true = moving()
    names = {"U": "Stellwert", "p1": "Druck vor", "p2": "Druck nach", "Q": "Durchfluss"}
    units = {"U": "%", "p1": "bar", "p2": "bar", "Q": "l/min"}
    values = dict(true)
    values[pair[0]], values[pair[1]] = true[pair[1]], true[pair[0]]
    for role, name in names.items():
        plant.add(name, values[role], units[role])
    (verdict,) = plant.verdicts()
    assert f"{pair[0]} and {pair[1]} are swapped" in " ".join(
        option.text for option in verdict.question.options
    )
    swapped = next(o for o in verdict.question.options if "swapped" in o.text)
    settled = obey(plant, verdict, swapped)
    assert settled.question is None
    assert settled.reading.nodes[Role(pair[0])].path[-1] == names[pair[1]]


def test_signals_of_no_stated_unit_are_asked_and_assumed_only_when_that_is_accepted(plant, moving):
    true = moving()
    for name, role in (("cmd", "U"), ("p_in", "p1"), ("p_out", "p2"), ("flow", "Q")):
        plant.add(name, true[role])
    (verdict,) = plant.verdicts()
    assert verdict.question.about == "p1, p2, Q: nothing states the unit"
    (accepted,) = plant.verdicts(assume=True)
    assert accepted.question is None
    gallons = next(o for o in verdict.question.options if "in gpm" in o.text)
    assert seen(obey(plant, verdict, gallons), "Q") == pytest.approx(
        3.785 * true["Q"].max(), rel=1e-3
    )


def test_names_without_meaning_are_assigned_by_units_and_physics(plant, moving):
    true = moving()
    for name, role, unit in (
        ("AI1", "Q", "l/min"), ("AI2", "p2", "bar"), ("AI3", "U", "%"), ("AI4", "p1", "bar"),
    ):  # fmt: skip
        plant.add(name, true[role], unit)
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert nodes(verdict) == {"U": "AI3", "p1": "AI4", "p2": "AI2", "Q": "AI1"}


def test_two_unknown_percentages_are_asked(plant, moving):
    still = 0 * moving()["U"]
    for name, value, unit in (
        ("AI1", 50, "%"),
        ("AI2", 60, "%"),
        ("p1", 150, "bar"),
        ("p2", 20, "bar"),
        ("Q", 30, "l/min"),
    ):
        plant.add(name, value + still, unit)
    (verdict,) = plant.verdicts()
    assert verdict.question.about == "U: ambiguous"


def test_a_flow_that_does_not_move_while_the_valve_does_is_asked(plant, moving):
    true = moving()
    rng = np.random.default_rng(1)
    plant.add("Stellwert", true["U"], "%")
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["p2"], "bar")
    plant.add("Volumenstrom", 63 + rng.normal(0, 0.2, len(true["U"])), "l/min")
    (verdict,) = plant.verdicts()
    labelled = next(o for o in verdict.question.options if o.text.startswith("as labelled"))
    assert "but Q does not move with U" in labelled.consequence


def test_a_cylinder_with_meter_and_two_chambers_is_not_taken_for_a_valve_of_two_ports(
    plant, moving
):
    true = moving()
    U = 80 * np.sin(1.3 * true["t"])
    pA, pB = 90 + 30 * np.sin(0.8 * true["t"]), 60 - 20 * np.sin(1.1 * true["t"])
    Q = np.where(U > 0, 0.05 * U * np.sqrt(180 - pA), 0.05 * U * np.sqrt(pA))
    plant.add("Stellsignal", U, "%", (-100.0, 100.0))
    plant.add("pA", pA, "bar")
    plant.add("pB", pB, "bar")
    plant.add("Q", Q, "l/min")
    plant.add("Zylinderweg", 400 + np.cumsum(Q) / 100, symbol="mm")
    (verdict,) = plant.verdicts()
    assert verdict.question is not None


def test_integers_without_a_range_may_be_tenths_and_are_asked(plant, moving):
    true = moving()
    plant.add("Stellwert", np.round(true["U"]), "%", largest=32_767)
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["p2"], "bar")
    plant.add("Durchfluss", np.round(10 * true["Q"]), "l/min", largest=32_767)
    (verdict,) = plant.verdicts()
    tenths = [
        o for o in verdict.question.options if "--scale=Plant.Q=0..1000:0..100l/min" in o.answers
    ]
    assert seen(obey(plant, verdict, tenths[0]), "Q") == pytest.approx(true["Q"].max(), abs=0.1)


def test_a_unit_in_the_property_that_contradicts_the_name_is_asked(plant, moving):
    true = moving()
    plant.add("Stellwert", true["U"], "%")
    plant.add("Druck vor [psi]", true["p1"], "bar")
    plant.add("Druck nach [psi]", true["p2"], "bar")
    plant.add("Durchfluss", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert verdict.question is not None


def test_a_solenoid_current_is_no_signal_of_4_to_20_mA(plant, moving):
    true = moving()
    plant.add("Ventilstrom", 8 * true["U"], "mA")
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["p2"], "bar")
    plant.add("Durchfluss", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert verdict.question is not None


def test_one_meter_for_two_valves_is_asked(plant, moving):
    one, other = moving(1), moving(2)
    for valve, true in (("V1", one), ("V2", other)):
        plant.add(("Press", valve, "Stellsignal"), true["U"], "%")
        plant.add(("Press", valve, "Druck vor"), true["p1"], "bar")
        plant.add(("Press", valve, "Druck nach"), true["p2"], "bar")
    plant.add(("Press", "Durchfluss"), one["Q"] + other["Q"], "l/min")
    verdicts = plant.verdicts()
    assert len(verdicts) == 2
    assert all("one meter for the valves V1, V2" in v.question.about for v in verdicts)
    for verdict in verdicts:
        assert "all are learnt together" in verdict.question.options[0].consequence
        settled = obey(plant, verdict, verdict.question.options[0])
        assert settled.question is None
        assert nodes(settled)["Q"] == "Durchfluss"


def test_gauges_without_a_unit_beside_a_meter_in_gpm_are_asked(plant, moving):
    true = moving()
    plant.add("VLV DRIVE PCT", true["U"])
    plant.add("PRESS IN", true["p1"])  # 180: bar, or psi as the meter's country has it
    plant.add("PRESS OUT", true["p2"])
    plant.add("FLOW GPM", true["Q"])
    (verdict,) = plant.verdicts()
    assert verdict.question.about == "p1, p2: nothing states the unit"
    assert {"bar", "psi"} <= {option.answers[-3].rsplit("=")[-1] for option in _both(verdict)}


def _both(verdict):
    return [o for o in verdict.question.options if o.text.startswith("as labelled")]


def test_a_signal_that_leaves_its_range_is_not_passed_over_for_another_one(plant, moving):
    true = moving()
    plant.add("Stellsignal", true["p2"] / 5, "V", (0.0, 10.0))  # exchanged with the pressure
    plant.add("Schieberposition", true["U"], "%", (0.0, 100.0))
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["U"] / 2, "bar")
    plant.add("Durchfluss", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert verdict.question is not None


def test_a_valve_at_rest_with_clear_labels_is_accepted_and_backwards_it_is_asked(plant):
    rng = np.random.default_rng(3)
    for name, level, unit in (
        ("Commande", 0.0, "%"), ("Pression amont", 207.0, "bar"), ("Débit", 0.0, "l/min"),
        ("Pression aval", 3.0, "bar"),
    ):  # fmt: skip
        plant.add(("Banc", "V1", name), level + rng.normal(0, 0.02, 200), unit)
        other = {207.0: 3.0, 3.0: 207.0}.get(level, level)
        plant.add(("Banc", "V2", name), other + rng.normal(0, 0.02, 200), unit)
    right, backwards = plant.verdicts()
    assert right.question is None
    assert "p2 is above p1" in backwards.question.about


def test_a_command_in_mA_without_a_range_is_asked(plant, moving):
    true = moving()
    plant.add("Stellsignal", 4 + 0.16 * true["U"], "mA")
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["p2"], "bar")
    plant.add("Durchfluss", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    scales = [answer for o in verdict.question.options for answer in o.answers if ".U=4" in answer]
    assert scales == ["--scale=Plant.U=4..20:0..100"]


def test_a_unit_of_another_quantity_is_named(plant, moving):
    true = moving()
    plant.add("Valve opening", true["U"], "%")
    plant.add("Pressure before", true["p1"], "bar")
    plant.add("Pressure after", true["p2"], "bar")
    plant.add("Flow", 0.87 * true["Q"], symbol="kg/min")
    (verdict,) = plant.verdicts()
    assert verdict.question.about == "Q in 'kg/min', which is no unit of a flow"


@pytest.mark.parametrize(
    ("signal", "symbol", "words"),
    [
        ("Pressure before", "Torr", "p1 in 'Torr', which is no unit of a pressure"),
        ("Valve opening", "promille", "U in 'promille', which is no unit of an opening"),
    ],
)
def test_a_stated_unit_that_is_none_of_ours_is_asked_for(plant, moving, signal, symbol, words):
    true = moving()
    named = {"Valve opening": ("U", "%"), "Pressure before": ("p1", "bar")}
    named |= {"Pressure after": ("p2", "bar"), "Flow": ("Q", "l/min")}
    for name, (role, unit) in named.items():
        if name == signal:
            plant.add(name, true[role], symbol=symbol)
        else:
            plant.add(name, true[role], unit)
    (verdict,) = plant.verdicts()
    assert verdict.question.about == words
    assert obey(plant, verdict, verdict.question.options[0]).question is None


@pytest.mark.parametrize("symbol", ["-", "кгс/см²"])
def test_a_dash_is_no_unit_and_technical_atmospheres_are_known(plant, moving, symbol):
    true = moving()
    factor = 1.0 if symbol == "-" else 0.980665
    plant.add("Valve opening", true["U"], "%")
    plant.add("Pressure before", true["p1"] / factor, symbol=symbol)
    plant.add("Pressure after", true["p2"] / factor, symbol=symbol)
    plant.add("Flow", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert seen(verdict, "p1") == pytest.approx(true["p1"].max())


@pytest.mark.parametrize("name", ["比例阀前压力（MPa）_3号", "p_in_MPa_1", "p in [MPa] #2"])
def test_a_unit_before_the_number_of_a_unit_is_read(plant, moving, name):
    true = moving()
    plant.add("V|cmd_%", true["U"])
    plant.add(name, true["p1"] / 10)
    plant.add("p_out", true["p2"], "bar")
    plant.add("flow", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert seen(verdict, "p1") == pytest.approx(true["p1"].max())


@pytest.mark.parametrize("valves", [1, 2])
def test_a_meter_beside_a_valve_without_one_is_asked_if_it_measures_both(plant, moving, valves):
    one, other = moving(1), moving(2)
    for valve, true in (("V1", one), ("V2", other)):
        plant.add(("Press", valve, "Stellsignal"), true["U"], "%")
        plant.add(("Press", valve, "Druck vor"), true["p1"], "bar")
        plant.add(("Press", valve, "Druck nach"), true["p2"], "bar")
    plant.add(("Press", "V1", "Durchfluss"), one["Q"] + (valves - 1) * other["Q"], "l/min")
    (verdict,) = plant.verdicts()
    if valves == 1:
        assert verdict.question is None
        return
    assert "its meter may measure V2, too" in verdict.question.about
    assert any(option.answers == ("--skip=V1",) for option in verdict.question.options)


def test_a_valve_that_is_shut_at_100_percent_is_asked_and_an_answer_is_obeyed(plant, moving):
    true = moving()
    plant.add("Stellsignal", 100 - true["U"], "%")
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["p2"], "bar")
    plant.add("Durchfluss", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    turned = next(o for o in verdict.question.options if "the valve is shut at 100" in o.text)
    settled = obey(plant, verdict, turned)
    assert settled.question is None
    assert seen(settled, "U") == pytest.approx(true["U"].max())


def test_a_valve_that_is_moved_below_zero_and_rests_at_zero_is_accepted(plant, moving):
    true = moving()
    U = np.where(true["U"] < 35, 0.0, true["U"])
    Q = 0.05 * U * np.sqrt(true["p1"] - true["p2"]) + np.random.default_rng(4).normal(
        -0.05, 0.1, 200
    )
    for name, values, unit in (
        ("Command", -U, "%"), ("Inlet pressure", true["p1"], "bar"),
        ("Outlet pressure", true["p2"], "bar"), ("Flow", Q, "l/min"),
    ):  # fmt: skip
        plant.add(name, values, unit=unit)
    (found,) = plant.verdicts()
    assert found.question is None
    assert found.reading.values[Role.U] == pytest.approx(-U)


@pytest.mark.parametrize(("name", "is_asked"), [("Load pressure", True), ("Tank pressure", False)])
def test_a_pressure_of_exactly_0_beside_a_valve_at_work_is_asked(plant, moving, name, is_asked):
    true = moving()
    Q = 0.05 * true["U"] * np.sqrt(true["p1"])
    for label, values, unit in (
        ("Command", true["U"], "%"), ("Inlet pressure", true["p1"], "bar"),
        (name, 0 * true["p2"], "bar"), ("Flow", Q, "l/min"),
    ):  # fmt: skip
        plant.add(label, values, unit=unit)
    (found,) = plant.verdicts()
    assert (found.question is not None) is is_asked
    if is_asked:
        assert "p2 is exactly 0 all the time" in found.question.about
        assert obey(plant, found, found.question.options[0]).question is None


def test_a_command_from_0_to_1_that_is_stated_in_percent_is_asked(plant, moving):
    true = moving()
    plant.add("Stellsignal", true["U"] / 100, "%")
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["p2"], "bar")
    plant.add("Durchfluss", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    first = verdict.question.options[0]
    assert first.text.startswith("U is in 1 instead of %")
    assert seen(obey(plant, verdict, first), "U") == pytest.approx(true["U"].max())


def test_flows_of_two_valves_that_are_exchanged_are_asked(plant, moving):
    one, other = moving(1), moving(2)
    for valve, true, Q in (("V1", one, other["Q"]), ("V2", other, one["Q"])):
        plant.add(("Press", valve, "Stellsignal"), true["U"], "%")
        plant.add(("Press", valve, "Druck vor"), true["p1"], "bar")
        plant.add(("Press", valve, "Druck nach"), true["p2"], "bar")
        plant.add(("Press", valve, "Durchfluss"), Q, "l/min")
    for verdict, valve in zip(plant.verdicts(), ("V2", "V1"), strict=True):
        first = verdict.question.options[0]
        assert first.text.startswith(f"Q is labelled as that of {valve}")
        assert f"Press/{valve}/Durchfluss" in " ".join(first.answers)


def test_a_command_in_volts_that_is_stated_in_percent_is_asked(plant, moving):
    true = moving()
    plant.add("Stellsignal", true["U"] / 10, "%")
    plant.add("Druck vor", true["p1"], "bar")
    plant.add("Druck nach", true["p2"], "bar")
    plant.add("Durchfluss", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    volts = next(o for o in verdict.question.options if o.text.startswith("U is in V"))
    assert seen(obey(plant, verdict, volts), "U") == pytest.approx(true["U"].max())


def test_constants_of_a_plant_that_is_off_are_accepted_once_our_units_are(plant):
    for name in ("Stellwert", "Druck vor Ventil", "Druck nach Ventil", "Volumenstrom"):
        plant.add(name, np.zeros(60))
    (verdict,) = plant.verdicts(assume=True)
    assert verdict.question is None
