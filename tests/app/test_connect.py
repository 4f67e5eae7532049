"""From a foreign server's address to a configuration that loads, without an editor."""

import shlex
from datetime import UTC, datetime

import pytest
from asyncua import ua

from support.foreign import PLANT, Foreign
from valvemap.cli import run
from valvemap.config.loading import load_config

SIGNALS = ("U", "p1", "p2", "Q")

pytestmark = pytest.mark.waits


@pytest.fixture
def foreign():
    started = []

    def start(names=PLANT, folders=("Ventil 1", "Ventil 2")):
        server = Foreign(names, folders)
        started.append(server)
        server.start()
        assert server.ready.wait(60)
        return server.url

    yield start
    for server in started:
        server.over.set()
        server.join(30)


def test_two_valves_of_a_foreign_server_become_a_configuration(foreign, tmp_path, capsys):
    out, data = tmp_path / "plant.toml", tmp_path / "data"
    asked = ["connect", foreign(), "--out", str(out), "--data", str(data), "--watch", "3", "--yes"]
    assert run(asked) == 0, capsys.readouterr().err
    config = load_config(out)
    assert [valve.name for valve in config.valves] == ["Ventil_1", "Ventil_2"]
    valve = config.valves[1]
    assert valve.nodes.p2 == "nsu=urn:plc;s=Ventil 2/Druck nach Ventil"
    assert valve.nodes.T == "nsu=urn:plc;s=Ventil 2/Öltemperatur"
    assert (valve.signals.U.raw, valve.signals.U.range) == ((4.0, 20.0), (0.0, 100.0))
    assert [getattr(valve.signals, s).unit for s in ("p1", "p2", "Q", "T")] == [
        "psi",
        "psi",
        "gpm",
        "°F",
    ]
    assert config.alignment.finds_timing
    assert "ms beside the others" in out.read_text(encoding="utf-8")
    assert config.source.security == "None"
    assert (data / "users.json").exists()


@pytest.mark.parametrize("units", [PLANT, {**PLANT, "Volumenstrom": (None, None)}])
def test_a_long_node_id_is_on_one_line_of_a_terminal_of_80_columns(
    foreign, tmp_path, capsys, units
):
    folder = "Halle 3, Linie 12, Aggregat 4, Schlitten links, Ventil 1"
    out = tmp_path / "plant.toml"
    run(
        [
            "connect",
            foreign(units, (folder,)),
            "--out",
            str(out),
            "--watch",
            "1",
            "--data",
            str(tmp_path),
        ]
    )
    lines = capsys.readouterr().out.splitlines()
    for name in ("Stellwert", "Druck vor Ventil", "Druck nach Ventil", "Volumenstrom"):
        assert [line for line in lines if line.endswith(f"nsu=urn:plc;s={folder}/{name}")]


def test_what_is_open_is_asked_and_nothing_is_written(foreign, tmp_path, capsys):
    names = {name: PLANT[name] for name in ("Stellwert", "Druck vor Ventil", "Volumenstrom")}
    out = tmp_path / "plant.toml"
    url = foreign(names, ("Ventil 1",))
    asked = ["connect", url, "--out", str(out), "--data", str(tmp_path), "--watch", "1", "--yes"]
    assert run(asked) == 1
    assert "p2: no node was found" in capsys.readouterr().err
    assert not out.exists()


def remedies(said):
    """The commands that a question offers, as arguments."""
    lines = [
        line.split("answer: valvemap ", 1)[1] for line in said.splitlines() if "answer: " in line
    ]
    return [shlex.split(line) for line in lines]


def test_a_question_names_commands_and_each_obeyed_writes_what_it_says(foreign, tmp_path, capsys):
    names = {**PLANT, "Volumenstrom": (None, None)}
    out, sheet = tmp_path / "plant.toml", tmp_path / "sheet.html"
    url = foreign(names, ("Ventil 1",))
    asked = ["connect", url, "--out", str(out), "--data", str(tmp_path), "--watch", "2"]
    assert run(asked) == 1
    said, failed = capsys.readouterr()
    assert "Ventil_1.Q: nothing states the unit" in failed
    assert not out.exists()
    units = {}
    for command in remedies(said):
        assert run([*command, "--force", "--sheet", str(sheet)]) == 0, capsys.readouterr().err
        units[command[-3]] = load_config(out).valves[0].signals.Q.unit
    assert units["--scale=Ventil_1.Q=gpm"] == "gpm"
    assert units["--scale=Ventil_1.Q=l/min"] is None
    page = sheet.read_text(encoding="utf-8")
    assert "Druck vor Ventil" in page
    assert "Signature" in page
    skipped = next(line for line in said.splitlines() if "to leave it out: " in line)
    assert run(shlex.split(skipped.split("valvemap ", 1)[1])) == 2


class WithArrays(Foreign):
    """Two valves as elements of arrays, one supply, and a card whose inputs have no names."""

    ARRAYS = ("ValveCommand", "LoadPressure", "Flow", "AI")

    def __init__(self):
        super().__init__({}, ("HPU",))

    async def add(self, server, index, folder):
        parent = await server.nodes.objects.add_object(index, folder)
        variables = [(name, [0.0] * (4 if name == "AI" else 2)) for name in self.ARRAYS]
        return [
            await parent.add_variable(ua.NodeId(name, index), name, value)
            for name, value in (*variables, ("SupplyPressure", 0.0))
        ]

    async def step(self, server, valves, k):
        now, supply = datetime.now(UTC), 160.0
        both = [self.move(2 * k + n, n, 0.0) for n in range(2)]
        U, loads = [b[0] for b in both], [supply - (b[1] - b[2]) for b in both]
        Q = [b[3] for b in both]
        columns = U, loads, Q, [U[0], supply, loads[0], Q[0]], supply
        for node, column in zip(valves[0], columns, strict=True):
            value = ua.DataValue(ua.Variant(column, ua.VariantType.Double), SourceTimestamp=now)
            await server.write_attribute_value(node.nodeid, value)


@pytest.fixture
def with_arrays():
    server = WithArrays()
    server.start()
    assert server.ready.wait(60)
    yield server.url
    server.over.set()
    server.join(30)


def test_elements_of_arrays_become_valves_and_one_without_names_by_answers(
    with_arrays, tmp_path, capsys
):
    out = tmp_path / "plant.toml"
    asked = ["connect", with_arrays, "--out", str(out), "--data", str(tmp_path), "--watch", "1"]
    assert run([*asked, "--yes"]) == 0, capsys.readouterr()
    nodes = [valve.nodes for valve in load_config(out).valves]
    assert [(n.U, n.p2, n.Q) for n in nodes] == [
        tuple(f"index={n};nsu=urn:plc;s={name}" for name in WithArrays.ARRAYS[:3]) for n in (0, 1)
    ]
    assert {n.p1 for n in nodes} == {"nsu=urn:plc;s=SupplyPressure"}
    names = [valve.name for valve in load_config(out).valves]
    answers = [f"--signal=AI.{s}=index={n};nsu=urn:plc;s=AI" for n, s in enumerate(SIGNALS)]
    skipped = [f"--skip={name}" for name in names]
    assert run([*asked, "--yes", *answers, *skipped]) == 0, capsys.readouterr()
    (valve,) = load_config(out).valves
    assert (valve.name, valve.nodes.Q) == ("AI", "index=3;nsu=urn:plc;s=AI")


def test_an_existing_configuration_is_checked_against_its_server(foreign, tmp_path, capsys):
    out, data = tmp_path / "plant.toml", tmp_path / "data"
    asked = ["connect", foreign(), "--out", str(out), "--data", str(data), "--watch", "2", "--yes"]
    assert run(asked) == 0
    assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0
    said = capsys.readouterr().out
    assert "Ventil_2.Q: " in said
    assert "hint" not in said
    text = out.read_text(encoding="utf-8")
    stamped = text.replace("[alignment]", "[alignment]\nfind_timing = false")
    out.write_text(stamped, encoding="utf-8")
    assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0
    assert "alignment.tolerance_ms = " in capsys.readouterr().out
    out.write_text(text.replace('p1 = { unit = "psi" }', ""), encoding="utf-8")
    assert run(["check-config", str(out), "--online"]) == 1
    assert "comes in psi, configured is bar: set unit = 'psi'" in capsys.readouterr().err
