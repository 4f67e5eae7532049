"""Units that a recording's values contradict are refused; the remedy that is named works."""

import ast
import re
import shlex

import numpy as np
import pytest

import valvemap
from valvemap.app.recorded_units import _scales
from valvemap.app.replay import replay
from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.errors import ConfigurationError, RecordingError
from valvemap.model.samples import Samples
from valvemap.pipeline.units import Measure, unit_of
from valvemap.plant.answers import parse_answers
from valvemap.plant.questions import Option
from valvemap.storage.layout import Part
from valvemap.storage.recording_writer import RecordingWriter

N = 800
START = 1_767_225_600 * 10**9


def rows(**changed):
    rng = np.random.default_rng(3)
    t = 0.05 * np.arange(N)
    U, p2 = 50 + 45 * np.sin(0.8 * t), 60 + 40 * np.sin(0.37 * t)
    Q = 0.04 * U * np.sqrt(190 - p2) + rng.normal(0, 0.1, N)
    plain = {"t": START + 50_000_000 * np.arange(N), "U": U, "p1": 190 + 0 * t, "p2": p2, "Q": Q}
    return plain | changed


def fitted(table, **options):
    return valvemap.fit(table, estimator="RLS", **options)


@pytest.fixture(scope="module")
def plain():
    """The model of samples whose units are right."""
    return fitted(rows())


def refusal(table, **options):
    with pytest.raises(RecordingError) as error:
        fitted(table, **options)
    said = str(error.value)
    assert "\n" not in said
    return said


@pytest.mark.parametrize(
    ("values", "units", "words"),
    [
        ({}, {"p1": "Pa", "p2": "Pa"}, "p1 and p2 are in bar instead of Pa"),
        ({}, {"p1": "Pa"}, "p1 is in bar instead of Pa"),
        ({}, {"p1": "kPa", "p2": "kPa"}, "p1 and p2 are in bar instead of kPa"),
        ({}, {"p2": "MPa"}, "p2 is in bar instead of MPa"),
        ({}, {"Q": "l/s"}, "Q is in l/min instead of l/s"),
        ({"p1": 19.0 + np.zeros(N), "p2": rows()["p2"] / 10}, {"p1": "bar", "p2": "MPa"}, "p1 is"),
        ({"U": rows()["U"] / 100}, {}, "U is in 1 instead of %"),
        ({"U": rows()["U"]}, {"U": "ratio"}, "U is in % instead of 1"),
    ],
)
def test_a_contradicted_unit_is_refused_and_its_remedy_works(values, units, words, plain):
    table = rows(**values)
    said = refusal(table, units=units)
    assert words in said
    remedy = ast.literal_eval(re.search(r"units=(\{.*?\})", said)[1])
    found = fitted(table, units=units | remedy)
    np.testing.assert_allclose(found.predict(50, 100), plain.predict(50, 100), rtol=1e-4)
    typed = re.search(r"(--scale .*?) \(units", said)[1]
    answers = [text for text in shlex.split(typed) if text != "--scale"]
    report = replay(table, units=units, estimators=["RLS"], given=parse_answers((), answers))
    assert report["Valvistor"]["RLS"].lane.count == N
    if "U" not in units:  # a U of 5,000 % teaches nothing
        assert fitted(table, units=units, insist=True).valve == "Valvistor"


def test_the_remedy_of_a_heading_and_of_a_configuration_are_their_own():
    table = {"p1 [Pa]" if name == "p1" else name: x for name, x in rows().items()}
    assert "--scale p1=bar says so, or the heading p1 [bar]" in refusal(table)
    signals = {"p1": {"unit": "Pa"}, "p2": {"unit": "Pa"}}
    config = Config(valves=[{"name": "Valvistor", "signals": signals}])
    wanted = 'signals.p1.unit = "bar", signals.p2.unit = "bar" in the configuration'
    assert wanted in refusal(rows(), config=config)


def test_what_is_plausible_is_learnt():
    psi = rows(p1=rows()["p1"] * 14.503773773, p2=rows()["p2"] * 14.503773773)
    fitted(psi, units={"p1": "psi", "p2": "psi"})
    closed = rows(U=np.zeros(N), Q=np.random.default_rng(1).normal(0, 0.1, N))
    fitted(closed)
    fitted(rows(U=rows()["U"] / 10), units={"U": "0..10:0..100%"})


@pytest.mark.parametrize(("unit", "ns"), [("ms", 10**6), ("us", 10**3)])
def test_epochs_in_other_units_are_refused_and_their_remedies_work(unit, ns, plain, tmp_path):
    table = rows(t=rows()["t"] // ns)
    said = refusal(table)
    assert f"name the column t [{unit}] (units={{'t': '{unit}'}} in Python)" in said
    headed = {f"t [{unit}]" if name == "t" else name: x for name, x in table.items()}
    file = tmp_path / "r.csv"
    text = [
        ",".join(headed),
        *(",".join(map(str, row)) for row in zip(*headed.values(), strict=True)),
    ]
    file.write_text("\n".join(text))
    for found in (fitted(table, units={"t": unit}), fitted(headed), fitted(file)):
        assert found.t == plain.t


def test_times_that_are_all_equal_are_refused():
    table = rows(t=np.full(N, START))
    assert "all times are equal" in refusal(table)
    assert fitted(table | {"t": np.arange(N) * 0.05}).t == 39_950_000_000


def test_units_as_likely_as_the_likeliest_are_named_beside_it_and_work():
    psi = rows(p1=rows()["p1"] * 14.503773773, p2=rows()["p2"] * 14.503773773)
    said = refusal(psi)
    assert "it may be that p1 and p2 are in kPa instead of bar" in said
    named = [ast.literal_eval(found) for found in re.findall(r"units=(\{.*?\})", said)]
    assert {"p1": "psi", "p2": "psi"} in named
    for units in named:
        fitted(psi, units=units)


def test_no_unit_is_proposed_where_none_explains_the_flow():
    half = np.where(np.arange(N) < N // 2, 1.0, 14.503773773)
    said = refusal(rows(p1=rows()["p1"] * half, p2=rows()["p2"] * half))
    assert "the orifice law explains" in said
    assert "units=" not in said


@pytest.mark.parametrize(("signal", "number"), [("U", 0.0), ("p1", -999.0), ("Q", 0.0)])
def test_a_number_that_stands_for_no_reading_is_refused_and_the_remedy_works(signal, number, plain):
    gone = np.random.default_rng(5).random(N) < 0.03
    values = rows()[signal]
    said = refusal(rows(**{signal: np.where(gone, number, values)}))
    assert f"{signal} is {number:g} in {gone.sum()} samples of {N}" in said
    found = fitted(rows(**{signal: np.where(gone, np.nan, values)}))
    assert found.predict(50, 100) == pytest.approx(plain.predict(50, 100), rel=0.01)


def test_a_temperature_in_kelvin_is_refused_and_the_remedy_works():
    T = 313.15 + np.sin(0.01 * np.arange(N))
    said = refusal(rows(T=T))
    assert "T is 312.2 … 314.1 °C, which no oil has" in said
    units = ast.literal_eval(re.search(r"units=(\{.*?\})", said)[1])
    assert pytest.approx(T[-1] - 273.15) == fitted(rows(T=T), units=units).T


def test_a_temperature_in_counts_is_refused_and_the_remedy_works():
    T = 11_000.0 + np.arange(N) % 7
    said = refusal(rows(T=T))
    assert "T is 1.1e+04 … 1.101e+04 °C, which no oil has" in said
    raw = re.search(r"--scale T=(\S+),", said)[1]
    assert pytest.approx(T[-1] / 276.48) == fitted(rows(T=T), units={"T": raw}).T


@pytest.mark.parametrize(
    ("symbol", "span", "U"),
    [
        ("V", "0..10:0..100%", lambda U: U / 10),
        ("mA", "4..20:0..100%", lambda U: 4 + 0.16 * U),
    ],
)
def test_a_command_that_fills_a_span_of_volts_or_mA_is_asked_for_its_unit(symbol, span, U):
    whole = np.clip(50 + 55 * np.sin(0.8 * 0.05 * np.arange(N)), 0, 100)
    Q = 0.04 * whole * np.sqrt(190 - rows()["p2"]) + np.random.default_rng(3).normal(0, 0.1, N)
    table = rows(U=U(whole), Q=Q)
    said = refusal(table)
    assert f"in {symbol}, --scale U={span}" in said
    wanted = fitted(rows(U=whole, Q=Q)).predict(50, 100)
    assert fitted(table, units={"U": span}).predict(50, 100) == pytest.approx(wanted)
    fitted(table, units={"U": "%"})
    fitted({"U [%]" if name == "U" else name: x for name, x in table.items()})


@pytest.mark.parametrize("stated", ["l/s", "m³/h"])
def test_the_name_plate_contradicts_a_wrong_unit_of_flow_and_the_remedy_works(stated):
    small = rows(Q=rows()["Q"] / 8)  # in any of these units it could be a valve's flow
    plate = {"rated_flow": 3.0, "rated_drop": 35.0}
    fitted(small, **plate)
    said = refusal(small, units={"Q": stated}, **plate)
    named = ast.literal_eval(re.search(r"units=(\{.*?\})", said)[1])
    assert named == {"Q": "l/min"}
    fitted(small, units=named, **plate)


def recorded(tmp_path, *valves):
    """Write what `valvemap record` writes of a valve; its numbers are in our units."""
    table = rows()
    samples = Samples.of(**{name: table[name] for name in ("t", "U", "p1", "p2", "Q")})
    file = tmp_path / "plant.csv"
    with RecordingWriter(file) as writer:
        for valve in valves:
            writer.append(valve, samples)
    return file


@pytest.mark.parametrize(
    "signals", ['p1 = { unit = "MPa" }', "U = { raw = [4, 20], range = [0, 100] }"]
)
def test_what_record_wrote_is_not_converted_again(tmp_path, signals, plain):
    config = tmp_path / "service.toml"
    nodes = "\n".join(f'{name} = "ns=2;s={name}"' for name in ("U", "p1", "p2", "Q"))
    config.write_text(
        f'[[valves]]\nname = "V7"\n[valves.nodes]\n{nodes}\n[valves.signals]\n{signals}\n',
        encoding="utf-8",
    )
    file = recorded(tmp_path, "V7")
    found = valvemap.fit(file, estimator="RLS", config=load_config(config))
    np.testing.assert_array_equal(found.predict(50.0, 100.0), plain.predict(50.0, 100.0))


def test_edges_and_lines_beside_a_valve_do_not_hinder_it(tmp_path):
    file = recorded(tmp_path, "V7", "Boom.LineA", "Boom.PA")
    fitted(file, valve="V7")
    with pytest.raises(ConfigurationError, match=r"Boom.LineA is an edge or a line of Boom"):
        fitted(file)


def test_a_remedy_names_the_signal_of_a_valve_whose_name_has_a_point():
    part = Part("Boom.PA", 0, {"p1": (2, Measure(unit=unit_of("Pa")).scaling("p1"))})
    option = Option("", "", ("--scale=Boom.PA.p1=0..10:0..2.5bar",), 1.0)
    assert _scales(option, part) == {"p1": "0..10:0..2.5bar"}
