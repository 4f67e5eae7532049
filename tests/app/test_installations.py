"""Plants as they are installed, on real servers: written rightly, or asked and obeyed."""

import shlex

import numpy as np
import pytest
from asyncua import ua

from support.installation import Installation, Tag
from valvemap.cli import run
from valvemap.config.loading import load_config


def U(t, phase=0.0):
    return 50 + 30 * np.sin(1.3 * t + phase) + 12 * np.sin(3.1 * t)


def load(t, phase=0.0):
    return 40 + 25 * np.sin(0.9 * t + phase)


def supply(t):
    return 180 + 4 * np.sin(0.5 * t)


def flow(t, phase=0.0):
    return 0.04 * U(t, phase) * np.sqrt(supply(t) - load(t, phase))


@pytest.fixture
def installed():
    started = []

    def start(*tags):
        server = Installation(tags)
        started.append(server)
        server.start()
        assert server.ready.wait(60)
        return server.url

    yield start
    for server in started:
        server.over.set()
        server.join(30)


def connect(url, tmp_path, *more):
    out = tmp_path / "plant.toml"
    common = ["--out", str(out), "--data", str(tmp_path), "--watch", "4", "--force"]
    return run(["connect", url, *common, *more]), out


@pytest.mark.waits
def test_two_valves_with_one_supply_pressure_are_written_and_checked(installed, tmp_path, capsys):
    url = installed(
        Tag(("Press", "Versorgungsdruck"), supply, "bar"),
        *(
            tag
            for valve, phase in (("V1", 0.0), ("V2", 2.0))
            for tag in (
                Tag(("Press", valve, "Stellsignal [%]"), lambda t, p=phase: U(t, p)),
                Tag(("Press", valve, "Lastdruck_kPa"), lambda t, p=phase: 100 * load(t, p)),
                Tag(("Press", valve, "流量m3/h"), lambda t, p=phase: 0.06 * flow(t, p)),
                Tag(("Press", valve, "Schieberposition [%]"), lambda t, p=phase: U(t, p) + 0.2),
                Tag(("Press", valve, "Werte"), lambda t: [t, t]),
            )
        ),
    )
    code, out = connect(url, tmp_path)
    _, failed = capsys.readouterr()
    assert code == 0, failed
    valves = load_config(out).valves
    assert [valve.name for valve in valves] == ["V1", "V2"]
    for valve in valves:
        assert valve.nodes.p1 == "nsu=urn:plc;s=Press/Versorgungsdruck"
        assert f"nsu=urn:plc;s=Press/{valve.name}/Stellsignal [%]" == valve.nodes.U
        assert (valve.signals.p2.unit, valve.signals.Q.unit) == ("kPa", "m³/h")
    assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0


@pytest.mark.waits
def test_counts_are_asked_with_commands_that_write_their_raw_range(installed, tmp_path, capsys):
    def counts(name, value, full):
        return Tag(("V7", name), lambda t: value(t) / full * 27_648, kind=ua.VariantType.Int16)

    url = installed(
        counts("Stellwert", U, 100),
        counts("Druck vor", supply, 250),
        counts("Druck nach", load, 250),
        counts("Durchfluss", flow, 100),
    )
    code, out = connect(url, tmp_path)
    said, _ = capsys.readouterr()
    assert code == 1
    assert not out.exists()
    commands = [
        line.split("answer: valvemap ")[1] for line in said.splitlines() if "answer: " in line
    ]
    wanted = "--scale=V7.p1=0..27648:0..250bar", "--scale=V7.Q=0..27648:0..100l/min"
    chosen = next(c for c in map(shlex.split, commands) if set(wanted) <= set(c))
    assert run(chosen) == 0, capsys.readouterr().err
    signals = load_config(out).valves[0].signals
    assert (signals.p1.raw, signals.p1.range) == ((0.0, 27_648.0), (0.0, 250.0))
    assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0


@pytest.mark.waits
def test_a_valve_of_four_ports_is_asked_for_its_edges(installed, tmp_path, capsys):
    def both(t):
        return 80 * np.sin(2.6 * t)  # both directions within 2.4 s

    def pA(t):
        return 90 + 20 * np.sin(0.8 * t)

    def QA(t):
        ahead = both(t) > 0
        return 0.05 * both(t) * np.sqrt(supply(t) - pA(t) if ahead else pA(t) - 3)

    url = installed(
        Tag(("Servo", "Command"), lambda t: both(t) / 10, "V", (-10.0, 10.0)),
        Tag(("Servo", "pP"), supply, "bar"),
        Tag(("Servo", "pT"), lambda t: 3.0 + 0 * t, "bar"),
        Tag(("Servo", "pA"), pA, "bar"),
        Tag(("Servo", "pB"), lambda t: 60 - 20 * np.sin(0.8 * t), "bar"),
        Tag(("Servo", "QA"), QA, "l/min"),
    )
    code, out = connect(url, tmp_path)
    said, failed = capsys.readouterr()
    assert code == 1
    assert "four ports" in failed
    every, one = (
        shlex.split(line.split("answer: valvemap ")[1])
        for line in said.splitlines()
        if "answer: " in line
    )
    assert run(every) == 0, capsys.readouterr().err
    edges = {valve.name: valve for valve in load_config(out).valves}
    assert {"Servo.PA", "Servo.AT"} <= set(edges)
    assert "# AT: the orifice law explains 100 % of QA while AT is open" in out.read_text("utf-8")
    assert edges["Servo.AT"].nodes.p2 == "nsu=urn:plc;s=Servo/pT"
    assert edges["Servo.AT"].signals.U.range == (-100.0, 100.0)
    assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0
    assert run(one) == 0, capsys.readouterr().err
    (valve,) = load_config(out).valves
    assert valve.nodes.p2 == "nsu=urn:plc;s=Servo/pA"
    assert (valve.signals.U.raw, valve.signals.U.range) == ((-10.0, 10.0), (-100.0, 100.0))
    assert valve.gate.U.low == 0.0
