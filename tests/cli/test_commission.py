"""`valvemap commission`: its plan without a plant, and what it refuses before it connects."""

import io

import pytest

from valvemap.cli import run
from valvemap.storage.commission_files import RunFiles

WRITTEN = """
[source]
url = "opc.tcp://127.0.0.1:1/"
security = "None"

[[valves]]
name = "V1"

[valves.nodes]
U = "ns=2;s=U"
p1 = "ns=2;s=p1"
p2 = "ns=2;s=p2"
Q = "ns=2;s=Q"
{nodes}

[valves.commission]
range_percent = [5, 80]
safe_percent = 5
slew_percent_per_s = 300
"""
COMMANDED = 'required_U = "ns=2;s=Command"\nheartbeat = "ns=2;s=Beat"'


@pytest.fixture
def commission(tmp_path, capsys, monkeypatch):
    """Runs the command on a configuration; returns its code and what it printed."""
    monkeypatch.setattr("sys.stdin", io.StringIO())

    def call(*arguments, nodes=COMMANDED, text=WRITTEN):
        file = tmp_path / "v.toml"
        file.write_text(text.format(nodes=nodes), encoding="utf-8")
        code = run(["commission", *arguments, "--config", str(file), "--data", str(tmp_path)])
        said = capsys.readouterr()
        return code, said.out + said.err

    return call


def test_a_dry_run_prints_limits_and_connects_to_nothing(commission):
    code, said = commission("V1", "--dry-run", "--accuracy", "0.5")
    assert code == 0
    for part in ("5 … 80 %", "300 %/s", "ns=2;s=Command", "± 0.5 l/min", "safe U     5 %"):
        assert part in said


@pytest.mark.parametrize(
    ("arguments", "nodes", "named"),
    [
        (["V2"], COMMANDED, "the configuration has V1"),
        (["V1"], "", "nodes.required_U is needed"),
        (["V1"], 'required_U = "ns=2;s=Command"', "nodes.heartbeat is needed"),
        (["V1"], COMMANDED, "--unattended"),
        (["V1", "--unattended", "--resume"], COMMANDED, "holds no run of valve V1"),
    ],
)
def test_a_wrong_use_is_one_line_with_its_remedy(commission, arguments, nodes, named):
    code, said = commission(*arguments, nodes=nodes)
    assert code == 2
    assert named in said
    assert len(said.strip().splitlines()) == 1


def test_a_safe_u_outside_the_range_names_the_field(commission):
    code, said = commission("V1", text=WRITTEN.replace("safe_percent = 5", "safe_percent = 0"))
    assert code == 2
    assert "safe_percent" in said


def test_a_complete_run_is_not_resumed(commission, tmp_path):
    with RunFiles(tmp_path / "commission" / "V1.20260101T000000Z.csv", "V1") as files:
        files.note({"event": "ended", "phase": "DONE", "reason": "", "elapsed_s": 60.01})
    code, said = commission("V1", "--unattended", "--resume")
    assert code == 2
    assert "--resume: the last run of V1 was complete; without --resume a new one begins" in said


def test_an_accuracy_that_is_no_number_is_refused(commission):
    for text in ("inf", "nan", "-1"):
        code, said = commission("V1", "--dry-run", "--accuracy", text)
        assert code == 2
        assert "--accuracy" in said


def test_the_plan_has_the_triangles_that_the_slew_permits(commission):
    slow = WRITTEN.replace("slew_percent_per_s = 300", "slew_percent_per_s = 10\nmost_s = 24")
    code, said = commission("V1", "--dry-run", text=slow)
    assert code == 0
    assert "U 5 … 80 % and back every 15 s, as the slew permits" in said
    assert "refinement none" in said
    assert "within 7.65 s" in said
