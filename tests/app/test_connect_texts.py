"""A signal that a server sends as text is named with what would help; it is not left out."""

from datetime import UTC, datetime

import pytest
from asyncua import ua

from support.foreign import Foreign
from valvemap.cli import run
from valvemap.opcua_source.text_values import number_in

pytestmark = pytest.mark.waits

NAMES = ("Stellwert", "Druck vor Ventil", "Druck nach Ventil", "Volumenstrom")
UNITS = ("%", "bar", "bar", "l/min")


class WithText(Foreign):
    """Two valves in all but names; of the second, the pressure upstream is a text."""

    def __init__(self):
        super().__init__({}, ("Ventil 1", "Ventil 2"))

    async def add(self, server, index, folder):
        parent = await server.nodes.objects.add_object(index, folder)
        nodes = []
        for name, unit in zip(NAMES, UNITS, strict=True):
            is_text = (folder, name) == ("Ventil 2", "Druck vor Ventil")
            node = ua.NodeId(f"{folder}/{name}", index)
            shown = name if is_text else f"{name} [{unit}]"
            value = "0,0 bar" if is_text else 0.0
            nodes.append((await parent.add_variable(node, shown, value), is_text))
        await parent.add_variable(ua.NodeId(f"{folder}/Typ", index), "Typ", "4WRZ 16")
        return nodes

    async def step(self, server, valves, k):
        now = datetime.now(UTC)
        for place, nodes in enumerate(valves):
            for (node, is_text), number in zip(nodes, self.move(k, place, 0.0), strict=True):
                value = f"{number:.1f} bar".replace(".", ",") if is_text else float(number)
                stamped = ua.DataValue(ua.Variant(value), SourceTimestamp=now)
                await server.write_attribute_value(node.nodeid, stamped)


def test_a_pressure_that_is_sent_as_text_is_asked_for_with_what_helps(tmp_path, capsys):
    server = WithText()
    server.start()
    assert server.ready.wait(60)
    node = "nsu=urn:plc;s=Ventil 2/Druck vor Ventil"
    asked = ["connect", server.url, "--out", str(tmp_path / "plant.toml"), "--data", str(tmp_path)]
    try:
        assert run([*asked, "--watch", "2"]) == 1
        said, failed = capsys.readouterr()
        assert f"Ventil_2.p1: no node was found ({node} sends a text, " in failed
        assert "publish its number, as REAL or INT" in failed
        assert "not used: Ventil 2/Druck vor Ventil: sends a text, " in said
        assert run([*asked, f"--signal=Ventil_2.p1={node}"]) == 2
        assert "the node sends a text, " in capsys.readouterr().err
    finally:
        server.over.set()
        server.join(30)


def test_texts_that_hold_more_than_a_number_are_none():
    kept = ("12.3", "12,3 bar", "1e3 l/min", " -4,5 % ")
    others = ("4WRZ 16", "12:30", "1.2.3", "2024-11-27", "12 Uhr", "", "bar")
    assert [text for text in (*kept, *others) if number_in(text)] == list(kept)
