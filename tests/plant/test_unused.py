"""A second valve with names that say nothing is asked for; what is left out has its reason."""

import numpy as np
import pytest

from valvemap.plant.answers import of_valve, parse_answers
from valvemap.plant.mirrors import mirrors
from valvemap.plant.unused import of_others, of_signals, unused


def well_named(plant, true, folder="Valve 1"):
    for name, key, unit in (
        ("Command", "U", "%"), ("Inlet pressure", "p1", "bar"),
        ("Outlet pressure", "p2", "bar"), ("Flow", "Q", "l/min"),
    ):  # fmt: skip
        plant.add(("Plant", folder, name), true[key], unit)


ODD = {
    "members of a structure": (
        "stValve[1]", ("rCtl", "U", None), ("rIn", "p1", None), ("rOut", "p2", None),
        ("rFl", "Q", None),
    ),
    "numbers with units": (
        "X7", ("A01", "U", "%"), ("A02", "p1", "bar"), ("A03", "p2", "bar"), ("A04", "Q", "l/min"),
    ),
    "elements of an array": (
        "Card", ("Data[0]", "U", None), ("Data[1]", "p1", None), ("Data[2]", "p2", None),
        ("Data[3]", "Q", None),
    ),
    "a flow without a name": (
        "V2", ("Command", "U", "%"), ("Inlet pressure", "p1", "bar"),
        ("Outlet pressure", "p2", "bar"), ("Meter", "Q", None),
    ),
    "unknown words": (
        "Siur", ("Ohjaus", "U", None), ("Mika", "p1", "bar"), ("Muu", "p2", "bar"),
        ("Virtaama", "Q", "l/min"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("odd", ODD.values(), ids=ODD.keys())
def test_a_second_valve_with_weak_names_is_asked_for_and_the_answer_is_right(plant, moving, odd):
    well_named(plant, moving())
    true, (folder, *rows) = moving(1, k=9.0), odd
    for name, key, unit in rows:
        plant.add(("Plant", folder, name), true[key], unit)
    first, second = plant.verdicts()
    assert first.question is None
    assert second.question is not None
    option = second.question.options[0]
    given = parse_answers(
        [a.removeprefix("--signal=") for a in option.answers if a.startswith("--signal=")],
        [a.removeprefix("--scale=") for a in option.answers if a.startswith("--scale=")],
    )
    name = second.valve
    _, obeyed = plant.verdicts({name: of_valve(given, name)})
    assert obeyed.question is None
    assert not obeyed.others
    nodes = {str(role): one.path[-1] for role, one in obeyed.reading.nodes.items()}
    assert nodes == {key: name for name, key, _ in rows}


def test_the_next_valve_in_tags_is_found_beside_one_in_a_folder(plant, moving):
    well_named(plant, moving())
    true = moving(1)
    for name, key, unit in (
        ("FCV-102 Cmd", "U", "%"), ("PT-102 IN", "p1", "bar"), ("PT-102 OUT", "p2", "bar"),
        ("FT-102", "Q", "l/min"),
    ):  # fmt: skip
        place = "Pressures" if name.startswith("PT") else "Others"
        plant.add(("Plant", place, name), true[key], unit)
    found = plant.verdicts()
    assert [one.question for one in found] == [None, None]


def test_a_mirror_of_a_valve_in_raw_counts_is_none_of_its_own(plant, moving):
    true = moving()
    well_named(plant, true)
    for number, (key, span) in enumerate((("U", 100), ("p1", 400), ("p2", 400), ("Q", 300))):
        counts = np.round(true[key] / span * 27_648)
        plant.add(("Plant", "Card", f"AI[{number}]"), counts, largest=32_767.0)
    (only,) = plant.verdicts()
    assert only.question is None


def ordinary(plant, rng, n):
    """Pumps, axes, heaters, a cooler and counters, none of them a valve."""

    def walk(low, high):
        x = np.cumsum(rng.normal(0, 1, n))
        return low + (high - low) * (x - x.min()) / np.ptp(x)

    for k in range(8):
        speed = walk(900, 1_500)
        for name, values, unit, symbol in (
            ("Speed", speed, None, "rpm"), ("Speed setpoint", speed + 1, None, "rpm"),
            ("Pressure", walk(100, 200), "bar", ""), ("Flow", 0.05 * speed, "l/min", ""),
            ("Load", walk(0, 100), "%", ""), ("Temperature", walk(40, 50), "°C", ""),
        ):  # fmt: skip
            plant.add(("Plant", f"Pump {k}", name), values, unit, symbol=symbol)
        for name, values, symbol in (
            ("Position", walk(0, 500), "mm"), ("Torque", walk(0, 50), "Nm"),
            ("State", walk(0, 9), ""),
        ):  # fmt: skip
            plant.add(("Plant", f"Axis {k}", name), values, symbol=symbol)
        for number in range(6):
            counted = np.cumsum(rng.integers(0, 2, n))
            plant.add(("Plant", f"Counters {k}", f"C{number}"), counted, largest=2.0**31)
    for name, values, unit in (
        ("Water flow", walk(60, 61), "l/min"), ("Water pressure in", walk(4, 4.1), "bar"),
        ("Water pressure out", walk(1, 1.1), "bar"), ("Fan speed", walk(0, 100), "%"),
    ):  # fmt: skip
        plant.add(("Plant", "Cooler", name), values, unit)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_ordinary_server_has_no_more_questions_and_a_handful_of_lines(plant, moving, seed):
    well_named(plant, moving())
    well_named(plant, moving(1), "Valve 2")
    n = len(moving()["t"])
    ordinary(plant, np.random.default_rng(seed), n)
    found = plant.verdicts()
    assert [one.valve for one in found if one.question is None] == ["Valve_1", "Valve_2"]
    assert not [one.question.about for one in found if one.question is not None]
    left = unused(plant.candidates, plant.groups, plant.all, plant.records)
    said = [*of_signals(left), *of_others(left)]
    assert len(said) <= 6
    assert "48 whose name and unit say nothing" in said[-1]
    assert len(left) == len(plant.candidates) - 8


def test_each_variable_that_is_left_out_has_its_reason(plant, moving):
    true = moving()
    well_named(plant, true)
    beside = {
        "Flow 2": (30 + 0 * true["t"], "l/min", ""), "Cylinder position": (true["t"], None, "mm"),
        "Rotation": (true["t"], None, "rpm"), "Xyzzy": (true["t"], None, ""),
    }  # fmt: skip
    for name, (values, unit, symbol) in beside.items():
        plant.add(("Plant", "Elsewhere", name), values, unit, symbol=symbol)
    plant.add(("Plant", "Valve 1", "Flow HMI"), np.round(true["Q"]), "l/min")
    plant.add(("Plant", "Heater", "Command"), 50 + 0 * true["t"], "%")
    plant.verdicts()
    left = plant.left()
    assert left["Flow 2"] == "a flow of no valve that was found"
    assert left["Cylinder position"] == "by name a position"
    assert left["Xyzzy"] == "whose name and unit say nothing"
    assert left["Command"].startswith("a command, but its pressures or its flow were not found")


def test_of_several_temperatures_that_are_as_likely_none_is_taken(plant, moving):
    true = moving()
    well_named(plant, true)
    for number in (1, 2):
        plant.add(("Plant", "Tank", f"Oil temperature {number}"), true["T"] + number, "°C")
    (only,) = plant.verdicts()
    assert only.question is None
    assert "T" not in {str(role) for role in only.reading.nodes}
    assert "--signal=Valve_1.T=NODE" in plant.left()["Oil temperature 1"]


def test_a_valve_that_shows_another_one_s_values_is_noted(plant, moving):
    well_named(plant, moving())
    well_named(plant, moving(), "HMI copy")
    well_named(plant, moving(1), "Valve 2")
    found = plant.verdicts()
    assert [one.question for one in found] == [None] * 3
    (line,) = mirrors(found, plant.records)
    assert line.startswith("HMI_copy: all its values are those of Valve_1; ")


def test_a_transmitter_of_the_drop_that_no_name_tells_is_asked_for(plant, moving):
    well_named(plant, moving())
    true = moving(1, k=9.0)
    for name, values, unit in (
        ("s1", true["U"], "%"), ("s2", true["p1"] - true["p2"], "bar"), ("s3", true["Q"], "l/min"),
    ):  # fmt: skip
        plant.add(("Plant", "Q3", name), values, unit)
    _, second = plant.verdicts()
    assert "--signal=Q3.dp=s=Plant/Q3/s2" in second.question.options[0].answers
