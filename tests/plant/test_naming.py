"""Valves are found in other languages and by other schemes of naming; what is open is asked."""

import numpy as np
import pytest

from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import group
from valvemap.plant.reading import Given, Record
from valvemap.plant.roles import Role
from valvemap.plant.scales import scales
from valvemap.plant.verdict import judge

LANGUAGES = {
    "German": (
        "Stellwert",
        "Druck vor Ventil",
        "Druck nach Ventil",
        "Volumenstrom",
        "Öltemperatur",
    ),
    "German, hydraulic": ("Ansteuerung", "Zulaufdruck", "Rücklaufdruck", "Durchfluss", "Öltemp"),
    "French": ("Consigne", "Pression amont", "Pression aval", "Débit", "Température huile"),
    "Spanish": ("Apertura", "Presión de entrada", "Presión de salida", "Caudal", "Temperatura"),
    "Italian": ("Comando valvola", "Pressione monte", "Pressione valle", "Portata", "Temperatura"),
    "Chinese": ("阀门开度", "阀前压力", "阀后压力", "流量", "油温"),
    "Portuguese": ("Comando", "Pressão entrada", "Pressão saída", "Vazão", "Temperatura óleo"),
    "Polish": (
        "Sygnał sterujący",
        "Ciśnienie przed zaworem",
        "Ciśnienie za zaworem",
        "Przepływ",
        "Temperatura oleju",
    ),
    "Russian": (
        "Управление",
        "Давление до клапана",
        "Давление после клапана",
        "Расход",
        "Температура масла",
    ),
    "Turkish": ("Kumanda", "Giriş basıncı", "Çıkış basıncı", "Debi", "Yağ sıcaklığı"),
    "Japanese": ("指令", "上流圧力", "下流圧力", "流量", "油温"),
    "Japanese, first and second": ("弁開度", "一次圧", "二次圧", "流量", "温度"),
    "Korean": ("지령", "입구압력", "출구압력", "유량", "유온"),
    "Czech": ("Povel", "Tlak před ventilem", "Tlak za ventilem", "Průtok", "Teplota oleje"),
    "Swedish": ("Styrsignal", "Tryck före ventil", "Tryck efter ventil", "Flöde", "Temperatur"),
    "Dutch, abbreviated": ("Aansturing_Proc", "DrukIn", "DrukUit", "Debiet", "Olietemp"),
    "Polish, abbreviated": (
        "Sterowanie",
        "Cisnienie_wej",
        "Cisnienie_wyj",
        "Przeplyw",
        "Temperatura",
    ),
    "Dutch": ("Stuursignaal", "Inlaatdruk", "Uitlaatdruk", "Debiet", "Temperatuur"),
    "English": ("ValveCommand", "InletPressure", "OutletPressure", "FlowRate", "OilTemperature"),
    "instruments": ("ZT-7", "PT-7 supply", "PT-7 return", "FT-7", "TT-7"),
    "data block": ('"DB7"."V"."cmd"', '"DB7"."V"."p1"', '"DB7"."V"."p2"', '"DB7"."V"."q"', None),
}
SIGNALS = ("U", "p1", "p2", "Q", "T")


def at(*path, unit=None, **more):
    return Candidate(f"s={'.'.join(path)}", path, unit_of(unit) if unit else None, **more)


def propose(candidates):
    """The verdicts by names alone; units that are not stated are accepted."""
    return [judge(one, Record(), Given(assume=True)) for one in group(candidates)]


def last_names(verdict):
    nodes = verdict.reading.nodes
    return tuple(nodes[s].path[-1] if s in nodes else None for s in SIGNALS)


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_folder_in_any_language_is_a_valve(language):
    names = LANGUAGES[language]
    others = ("Pump speed", "Alarm", "Füllstand", "Laufzeit")
    found = propose(at("Plant", "Press 3", name) for name in (*names, *others) if name)
    assert [last_names(proposal) for proposal in found] == [names]
    assert found[0].question is None


def test_folders_of_equal_content_are_valves_of_their_own():
    places = [("Line", "V1"), ("Line", "V2"), ("Spare", "V1")]
    found = propose(at(*place, name) for place in places for name in LANGUAGES["German"])
    assert [proposal.valve for proposal in found] == ["Line_V1", "Line_V2", "Spare_V1"]


def test_flat_tags_are_parted_by_the_number_of_their_loop():
    kinds = ("FCV{}_CMD", "PT{}_IN", "PT{}_OUT", "FT{}")
    found = propose(at("Tags", kind.format(loop)) for loop in (101, 102) for kind in kinds)
    assert [proposal.valve for proposal in found] == ["V101", "V102"]
    assert last_names(found[1])[:4] == ("FCV102_CMD", "PT102_IN", "PT102_OUT", "FT102")


def test_data_blocks_are_parted_by_what_stands_before_the_last_name():
    names = [f'"DB10"."FCV-{k}"."{n}"' for k in (1, 2) for n in ("cmd", "p_in", "p_out", "flow")]
    found = propose(at("PLC", name) for name in names)
    assert [proposal.valve for proposal in found] == ["FCV-1", "FCV-2"]


def test_kks_codes_say_what_is_measured_and_leave_open_which_pressure_it_is():
    codes = {"CG001": "%", "CP001": "bar", "CP002": "bar", "CF001": "l/min", "CT001": "°C"}
    found = propose(
        at("KKS", f"{system}{code}", unit=unit)
        for system in ("10MAX11", "10MAX12")
        for code, unit in codes.items()
    )
    assert [proposal.valve for proposal in found] == ["V10MAX11", "V10MAX12"]
    assert found[0].question.about == "p1, p2: ambiguous"


def test_elements_of_arrays_are_parted_by_their_index_and_share_what_has_none():
    kinds = ("ValveCmd", "LoadPress", "Flow")
    names = [("HPU", kind, f"{kind}[{n}]") for n in (0, 1) for kind in kinds]
    found = propose(at(*name) for name in (*names, ("HPU", "SupplyPress")))
    assert [last_names(one)[:4] for one in found] == [
        (f"ValveCmd[{n}]", "SupplyPress", f"LoadPress[{n}]", f"Flow[{n}]") for n in (0, 1)
    ]


@pytest.mark.parametrize(
    ("text", "unit", "seen", "read"),
    [
        ("4-20 mA = 0-400 bar", "mA", 12.0, ["4..20:0..400bar"]),
        ("0..27648 = 0..250 bar", None, 13_000.0, ["0..27648:0..250bar"]),
        ("4...20 mA: 0...25 MPa", "MPa", 12.0, ["MPa"]),
        ("4...20 mA: 0...400 bar", None, 200.0, ["bar"]),
        ("4...20 mA: 0...400 bar", None, 12.0, ["4..20:0..400bar", "bar"]),
    ],
)
def test_a_span_in_the_comment_scales_raw_numbers(text, unit, seen, read):
    pressure = at("V", "pIn", unit=unit, description=text)
    assert [s.text for s in scales(pressure, Role.P1, np.array([seen]))] == read


def test_a_unit_outweighs_a_name():
    found = propose(
        at("X", name, unit=unit)
        for name, unit in (("a", "%"), ("b in", "psi"), ("c out", "psi"), ("d", "gpm"), ("q", "°C"))
    )
    assert last_names(found[0]) == ("a", "b in", "c out", "d", "q")


def test_the_signal_is_preferred_to_the_command_that_the_rig_takes_and_two_alike_are_asked():
    names = {"U": "%", "p1": "bar", "p2": "bar", "Q": "l/min", "UCommand": "%"}
    found = propose(at("TestRig", "Valvistor", n, unit=u) for n, u in names.items())
    assert (last_names(found[0])[0], found[0].question) == ("U", None)
    twice = propose(at("V", n) for n in ("cmd A", "cmd B", "p1", "p2", "flow"))
    assert twice[0].question.about == "U: ambiguous"
    assert ["cmd A" in option.text for option in twice[0].question.options] == [True, False]


def test_a_server_without_a_valve_has_none_and_half_a_valve_names_what_is_missing():
    assert propose([at("Server", "Speed"), at("Server", "Alarm")]) == []
    (half,) = propose(at("V", name) for name in ("Stellwert", "Vordruck", "Durchfluss"))
    assert half.question.about == "p2: no node was found"


def test_the_name_above_says_of_what_a_value_is_and_a_device_s_name_does_not():
    def role(*path):
        return Candidate("n", path).label.role

    assert role("Valve1", "Flow", "Value") is Role.Q
    assert role("Valve1", "Pressure", "Inlet") is Role.P1
    assert role("Valve1", "Pressure[1]", "Value") in {Role.P1, Role.P2}
    assert not Candidate("n", ("Flow valve", "Value")).label.is_relevant
    assert not Candidate("n", ("Flow", "Count")).label.is_relevant


def test_words_without_their_vowels_and_statistics_are_known():
    assert Candidate("n", ("hyd_vlv3_dmd_pc",)).label.role is Role.U
    assert Candidate("n", ("hyd_vlv3_us_prs_bar",)).label.role is Role.P1
    flow, mean = (Candidate("n", (name,)).label for name in ("Flow", "Flow average"))
    assert mean.gain(Role.Q) < flow.gain(Role.Q)
