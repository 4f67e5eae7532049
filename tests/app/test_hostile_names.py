"""`connect` at a server that names its nodes to hurt: the good valves are found, the TOML loads."""

import random
import tomllib

import pytest
from asyncua import ua

from support.foreign import PLANT, Foreign
from valvemap.cli import run
from valvemap.config.loading import load_config

PARTS = (
    *(chr(code) for code in (*range(32), *range(0x7F, 0xA0))),
    "\x1b[2J",
    "\x1b]0;owned\x07",
    "\u202e",
    "\u2066",
    "\ufeff",
    "\u2028",
    "\U000e0001",
    "a" + "\u0336" * 400,
    '"',
    "\\",
    "'",
    '"""',
    "#",
    ";",
    "=",
    "]]",
    "[/]",
    "[bold red]",
    "{0}",
    "%s",
    "\udcff",
    "",
    " ",
    "x" * 5_000,
    "Ölpresse",
)
IDENTIFIERS = set()
ROLES = ("Stellwert", "Druck vor Ventil", "Druck nach Ventil", "Volumenstrom")


def hostile(rng):
    return "".join(rng.choices(PARTS, k=rng.randint(1, 4)))


class Hostile(Foreign):
    """200 hostile valves and 200 variables of no valve beside two good ones: 1,000 names."""

    async def add(self, server, index, folder):
        nodes = await super().add(server, index, folder)
        if folder != self.folders[0]:
            return nodes
        rng = random.Random(7)
        for number in range(200):
            await self.valve(server, index, f"{hostile(rng)}{number}", rng)
        for number in range(200):
            name = f"{hostile(rng)}{number}"
            await server.nodes.objects.add_variable(ua.NodeId(name, index), name, 0.0)
        return nodes

    @staticmethod
    async def valve(server, index, folder, rng):
        parent = await server.nodes.objects.add_object(ua.NodeId(folder, index), folder)
        for role in ROLES:
            name = f"{role}{hostile(rng)}"
            await parent.add_variable(ua.NodeId(f"{folder}/{name}", index), name, 0.0)
            IDENTIFIERS.add(f"{folder}/{name}")


@pytest.fixture(scope="module")
def url():
    server = Hostile(PLANT, ("Ventil 1", "Ventil 2"))
    server.start()
    assert server.ready.wait(120)
    yield server.url
    server.over.set()
    server.join(30)


@pytest.mark.waits
def test_among_a_thousand_hostile_names_the_good_valves_are_found(url, tmp_path, capfd):
    out = tmp_path / "plant.toml"
    run(["connect", url, "--out", str(out), "--data", str(tmp_path), "--watch", "3", "--yes"])
    said, failed = capfd.readouterr()
    for line in (said + failed).split("\n"):
        assert line.isprintable(), ascii(line)
    text = out.read_text(encoding="utf-8")
    assert all(line.isprintable() for line in text.split("\n"))
    valves = {valve["name"]: valve["nodes"] for valve in tomllib.loads(text)["valves"]}
    assert len(valves) > 100
    assert valves["Ventil_1"]["Q"] == "nsu=urn:plc;s=Ventil 1/Volumenstrom"
    assert valves["Ventil_2"]["p2"] == "nsu=urn:plc;s=Ventil 2/Druck nach Ventil"
    made = {f"nsu=urn:plc;s={identifier}" for identifier in IDENTIFIERS}
    hostile_nodes = [
        n for nodes in valves.values() for n in nodes.values() if ";s=Ventil " not in n
    ]
    assert made >= set(hostile_nodes), "the same NodeIds, character by character"
    assert "skipped: " in said
    known = load_config(out)
    assert {"Ventil_1", "Ventil_2"} <= {valve.name for valve in known.valves}
