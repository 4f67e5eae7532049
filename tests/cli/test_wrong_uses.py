"""Fifty ways to ask wrongly: each is one line with the thing, the place and the remedy.

The exit code is 2 where command line or configuration are wrong or name what is not there,
and 1 where what was asked could not be done with what is there.
"""

import pytest

from valvemap.cli import run

NODES = "[valves.nodes]\nU = 's=U'\np1 = 's=1'\np2 = 's=2'\nQ = 's=3'\n"
VALVE = "[[valves]]\nname = 'V7'\n"
SOURCES = (
    "[[sources]]\nname = 'north'\nurl = 'opc.tcp://n:1'\n"
    "[[sources]]\nname = 'south'\nurl = 'opc.tcp://s:1'\n"
    "[[valves]]\nname = 'A'\nsource = 'north'\n[[valves]]\nname = 'B'\nsource = 'south'\n"
)
ROWS = "".join(f"{i},{37 * i % 100},{60 + 7 * i % 90},5,{i % 50}\n" for i in range(60))
FILES = {
    "ok.csv": "t,U,p1,p2,Q\n" + ROWS,
    "empty.csv": "",
    "named.csv": "Zeit,Stellung,pa,pb,Fluss\n" + ROWS,
    "word.csv": "t,U,p1,p2,Q\n0,1,2,3,offen\n",
    "thousands.csv": "t;U;p1;p2;Q\n0;1.00,5;2;3;4\n",
    "dates.csv": "t,U,p1,p2,Q\n03/04/2026 08:00:00,1,2,3,4\n",
    "swapped.csv": "t,U,p2,p1,Q\n" + ROWS,
    "pascal.csv": "t,U,p1,p2,Q\n"
    + "".join(f"{i},{i},{2e7 + 1e4 * i},500000,{i}\n" for i in range(60)),
    "backwards.csv": "t,U,p1,p2,Q\n" + "".join(reversed(ROWS.splitlines(keepends=True))),
    "all_bad.csv": "t,U,p1,p2,Q,quality\n" + ROWS.replace("\n", ",Bad\n"),
    "raw.csv": "t,U [mA],p1,p2,Q\n" + ROWS,
    "furlongs.csv": "t,U,p1 [furlong],p2,Q\n" + ROWS,
    "text.txt": "hello",
    "no_table.toml": "[source\n",
    "unknown.toml": "[source]\nspeed = 1\n",
    "misspelt.toml": "[source]\npublishing_intervall_ms = 100\n",
    "url.toml": "[source]\nurl = 'http://plc'\n",
    "port.toml": "[server]\nurl = 'opc.tcp://plc'\n",
    "name.toml": "[[valves]]\nname = 'a b'\n",
    "node.toml": "[[valves]]\n" + NODES.replace("s=U", "U"),
    "kind.toml": "[[valves]]\n[[valves.estimators]]\nkind = 'KF'\n",
    "policy.toml": "[source]\nsecurity = 'Basic128'\n",
    "unit.toml": VALVE + "[valves.signals]\np1 = { unit = 'furlong' }\n",
    "flow.toml": VALVE + "[valves.signals]\np1 = { unit = 'gpm' }\n",
    "ma.toml": VALVE + "[valves.signals]\nU = { unit = 'mA' }\n",
    "half.toml": VALVE + "[valves.signals]\nU = { raw = [4, 20] }\n",
    "point.toml": VALVE + "[valves.signals]\nU = { raw = [4, 4], range = [0, 100] }\n",
    "command.toml": VALVE
    + NODES
    + "required_U = 's=C'\n[valves.signals]\nU = { raw = [4, 20], range = [0, 100] }\n",
    "column.toml": VALVE + "[valves.signals]\nU = { column = 'Stellgröße' }\n",
    "number.toml": "valves = 3\n",
    "word.toml": "[source]\nqueue_size = 'many'\n",
    "twice.toml": VALVE + VALVE,
    "two.toml": VALVE + "[[valves]]\nname = 'V8'\n",
    "sources.toml": SOURCES,
    "mixed.toml": "[source]\n" + SOURCES,
    "elsewhere.toml": SOURCES.replace("source = 'north'", "source = 'west'"),
    "empty.json": "{}",
    "no.json": "nope",
    "demands.csv": "Q,pressure\n1,2\n",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wrong")
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def uses(code, *pairs):
    return [pytest.param(line, code, said, id=line) for line, said in pairs]


ASKED_WRONGLY = uses(
    2,
    ("frobnicate", ["frobnicate"]),
    ("replay", ["files"]),
    ("replay ok.csv --frob", ["--frob"]),
    ("replay none.csv", ["none.csv does not exist"]),
    ("replay opc.tcp://plc:4840", ["opc.tcp://plc:4840", "--from T", "2026-12-31T08:00"]),
    ("replay ok.csv --from 2026-12-31", ["--from", "only with the opc.tcp://"]),
    ("replay opc.tcp://plc:4840 --from soon", ["--from soon", "ISO 8601"]),
    ("replay opc.tcp://p:1 --from 2026-12-31 --to 2026-12-30", ["--to 2026-12-30", "is before"]),
    ("replay opc.tcp://plc:4840 ok.csv --from 0", ["opc.tcp://plc:4840", "one server alone"]),
    ("replay opc.tcp://p:1 --from 0 --config sources.toml", ["opc.tcp://p:1", "opc.tcp://n:1"]),
    ("record x.csv --config sources.toml", ["--source NAME", "north, south"]),
    ("record x.csv --config sources.toml --source west", ["--source west", "north, south"]),
    ("record x.csv --source west", ["--source west", "[source] alone"]),
    ("check-config nowhere.toml", ["nowhere.toml", "valvemap init"]),
    ("check-config mixed.toml", ["mixed.toml", "[source] and [[sources]]", "only one"]),
    ("check-config elsewhere.toml", ["valves[0].source = 'west'", "north, south"]),
    ("replay ok.csv --verify none.csv", ["none.csv does not exist"]),
    ("replay text.txt", ["text.txt", "must end in .csv"]),
    ("replay ok.csv --config none.toml", ["none.toml", "valvemap init"]),
    ("replay ok.csv --json nowhere/x.json", ["--json", "there is no folder nowhere"]),
    ("replay ok.csv --save nowhere/x.json", ["--save", "there is no folder nowhere"]),
    ("replay raw.csv", ["raw.csv, line 1", "'U [mA]'", "signals.U.raw and .range", "[4, 20]"]),
    ("replay furlongs.csv", ["furlongs.csv", "'furlong' is no unit", "signals.p1.unit may be"]),
    ("record nowhere/x.csv", ["there is no folder nowhere; make it"]),
    ("record x.txt", ["x.txt", "must end in .csv"]),
    ("record ok.csv", ["FILE ok.csv: is there already", "--force"]),
    ("record x.csv --duration -1", ["--duration", "greater than or equal to 0"]),
    ("serve", ["data/users.json", "valvemap init"]),
    ("serve --config none.toml", ["none.toml", "valvemap init"]),
    ("rig", ["data/users.json", "valvemap init"]),
    ("rig --scenario circus", ["circus", "built in: demo"]),
    ("rig --offline", ["--offline needs --record FILE and --duration S"]),
    ("rig --valves 0", ["--valves", "greater than or equal to 1"]),
    ("demo --duration soon", ["--duration", "valid number"]),
    ("check-config", ["FILE"]),
    ("check-config no_table.toml", ["no_table.toml: not valid TOML", "line 1"]),
    ("check-config unknown.toml", ["source.speed: there is no such field; there are url"]),
    ("check-config misspelt.toml", ["is publishing_interval_ms meant?"]),
    ("check-config url.toml", ["source.url = 'http://plc'", "opc.tcp://HOST:PORT/PATH"]),
    ("check-config port.toml", ["server.url = 'opc.tcp://plc'", "opc.tcp://HOST:PORT/PATH"]),
    ("check-config name.toml", ["valves[0].name = 'a b'", "a letter, then letters, digits"]),
    ("check-config node.toml", ["valves[0].nodes.U = 'U'", "ns=2;s=NAME"]),
    ("check-config kind.toml", ["kind 'KF'", "'RLS', 'RML', 'RBF', 'Auto'"]),
    ("check-config policy.toml", ["source.security = 'Basic128'", "'Aes256Sha256RsaPss'"]),
    ("check-config unit.toml", ["signals.p1.unit = 'furlong'", "allowed is one of %, 1, bar"]),
    ("check-config flow.toml", ["p1.unit = 'gpm' is a unit of flow; a unit of pressure"]),
    ("check-config ma.toml", ["signals.U", "raw = [4, 20] and range = [0, 100]"]),
    ("check-config half.toml", ["raw is given without range", "range = [0, 100]"]),
    ("check-config point.toml", ["signals.U.raw = [4, 4]: the two must differ"]),
    ("check-config command.toml", ["signals.required_U", 'unit = "%"']),
    ("check-config number.toml", ["valves = 3", "a list is needed"]),
    ("check-config word.toml", ["source.queue_size = 'many'", "valid integer"]),
    ("check-config twice.toml", ["valve name 'V7' is taken twice"]),
    ("invert ok.csv", ["give --Q and --dp, or --from a CSV file"]),
    ("invert ok.csv --Q a --dp 2", ["--Q a", "numbers with commas between"]),
    ("invert none.json --Q 1 --dp 2", ["none.json: no such file"]),
    ("invert ok.csv --from none.csv", ["none.csv: no such file", "Q,dp"]),
    ("export ok.csv", ["--to"]),
    ("export ok.csv --to x.doc", ["x.doc", ".csv, .c, .st, .fmu are allowed"]),
    ("export ok.csv --to nowhere/x.c", ["there is no folder nowhere"]),
    ("trust --user x", ["--user NAME, --role ROLE and FILE"]),
    ("trust text.txt --user x --role king", ["role 'king'", "observer, operator, engineer"]),
    ("trust --of plc x", ["--of plc", "service, rig"]),
    ("init --data text.txt", ["text.txt", "a folder is needed"]),
)
NOT_TO_BE_DONE = uses(
    1,
    ("replay empty.csv", ["empty.csv is empty", "t,U,p1,p2,Q"]),
    ("replay named.csv", ["named.csv, line 1", "U, p1, p2, Q is missing", "valves.signals.U"]),
    ("replay word.csv", ["word.csv, line 2", "Q is 'offen'", "a number"]),
    ("replay thousands.csv", ["thousands.csv, line 2", "U is '1.00.5'", "a number"]),
    ("replay dates.csv", ["dates.csv, line 2", "03/04/2026", "write 2026-12-31T08:00:00"]),
    ("replay swapped.csv", ["swapped.csv", "p1 is below p2 in 100 %", "swapped?", "--insist"]),
    ("replay pascal.csv", ["p1 and p2 are in Pa instead of bar", "--insist"]),
    ("replay backwards.csv", ["the times run backwards", "sort the rows by t"]),
    ("replay all_bad.csv", ["nothing was learnt from 60 samples: bad status 60"]),
    ("replay ok.csv --config two.toml", ["whose rows are these?", "a column valve"]),
    ("replay ok.csv --config column.toml", ["'Stellgröße' (signals.U.column of valve V7)"]),
    ("invert empty.json --Q 1 --dp 2", ["empty.json"]),
    ("invert no.json --Q 1 --dp 2", ["no.json: not JSON"]),
    ("invert ok.csv --from demands.csv", ["demands.csv: line 1: no column dp"]),
    ("trust nobody", ["nobody", "data/pki/service/rejected"]),
)


def test_there_are_fifty_of_them():
    assert len(ASKED_WRONGLY) >= 50


@pytest.mark.parametrize(("line", "code", "said"), [*ASKED_WRONGLY, *NOT_TO_BE_DONE])
def test_a_wrong_use_is_one_line_with_thing_place_and_remedy(
    folder, monkeypatch, capsys, line, code, said
):
    monkeypatch.chdir(folder)
    assert run(line.split()) == code
    *progress, last = capsys.readouterr().err.strip().splitlines()
    assert last.startswith("valvemap: ")
    assert not any(earlier.startswith("valvemap: ") for earlier in progress)
    for words in said:
        assert words in last
    assert "^" not in last  # no regular expression
    assert len(last) < 400


def test_each_wrong_field_of_a_configuration_has_a_line(tmp_path, capsys):
    file = tmp_path / "plant.toml"
    file.write_text("[source]\nurl = 3\n[alignment]\nreorder_ms = -1\n", encoding="utf-8")
    assert run(["check-config", str(file)]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f"valvemap: {file}: source.url = 3")
    assert second.startswith(f"{file}: alignment.reorder_ms = -1")
