"""From a foreign server's address to a configuration that loads, without an editor."""

import asyncio
import threading
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from asyncua import Server, ua

from service.cli import run
from service.config.loading import load_config

PSI, GALLON = 14.503773773, 3.785411784


def information(code, symbol):
    number = int.from_bytes(code.encode(), "big")
    uri = "http://www.opcfoundation.org/UA/units/un/cefact"
    return ua.EUInformation(uri, number, ua.LocalizedText(symbol), ua.LocalizedText(symbol))


PLANT = {
    "Stellwert": (information("4K", "mA"), ua.Range(4.0, 20.0)),
    "Druck vor Ventil": (information("PS", "psi"), None),
    "Druck nach Ventil": (information("PS", "psi"), None),
    "Volumenstrom": (information("G2", "gpm"), None),
    "Öltemperatur": (information("FAH", "°F"), None),
    "Drehzahl Pumpe": (None, None),
}


class Foreign(threading.Thread):
    """A server of another make in a thread of its own: 20 Hz, one signal 3 ms after the other."""

    def __init__(self, names, folders):
        super().__init__(daemon=True)
        self.names, self.folders, self.url = names, folders, None
        self.ready, self.over = threading.Event(), threading.Event()

    def run(self):
        asyncio.run(self.serve())

    async def serve(self):
        server = Server()
        await server.init()
        server.set_endpoint("opc.tcp://127.0.0.1:0/plc/")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        index = await server.register_namespace("urn:plc")
        nodes = [await self.add(server, index, folder) for folder in self.folders]
        async with server:
            port = server.bserver._server.sockets[0].getsockname()[1]
            self.url = f"opc.tcp://127.0.0.1:{port}/plc/"
            self.ready.set()
            k = 0
            while not self.over.is_set():
                await self.step(server, nodes, k := k + 1)
                await asyncio.sleep(0.05)

    async def add(self, server, index, folder):
        parent = await server.nodes.objects.add_object(index, folder)
        nodes = []
        for name, (unit, bounds) in self.names.items():
            node = await parent.add_variable(ua.NodeId(f"{folder}/{name}", index), name, 0.0)
            if unit is not None:
                await node.add_property(0, "EngineeringUnits", unit)
            if bounds is not None:
                await node.add_property(0, "EURange", bounds)
            nodes.append(node)
        return nodes

    async def step(self, server, valves, k):
        now, rng = datetime.now(UTC), np.random.default_rng(k)
        U, dp = rng.uniform(5, 95), rng.uniform(20, 150)
        values = [4 + 0.16 * U, (dp + 5) * PSI, 5 * PSI, 0.1 * U * dp**0.5 / GALLON, 104.0, 1500.0]
        for nodes in valves:
            for place, (node, value) in enumerate(zip(nodes, values, strict=False)):
                late = now + timedelta(milliseconds=3 * place)
                await server.write_attribute_value(
                    node.nodeid, ua.DataValue(ua.Variant(float(value)), SourceTimestamp=late)
                )


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
    assert 12.0 <= config.alignment.tolerance_ms <= 40.0
    assert config.source.security == "None"
    assert (data / "users.json").exists()


def test_what_is_open_is_asked_and_written_into_the_proposal(foreign, tmp_path, capsys):
    names = {name: PLANT[name] for name in ("Stellwert", "Druck vor Ventil", "Volumenstrom")}
    out = tmp_path / "plant.toml"
    url = foreign(names, ("Ventil 1",))
    asked = ["connect", url, "--out", str(out), "--data", str(tmp_path), "--watch", "1", "--yes"]
    assert run(asked) == 1
    assert "p2: no node was found" in capsys.readouterr().err
    assert '# p2 = "" # decide: no node was found' in out.read_text(encoding="utf-8")


def test_an_existing_configuration_is_checked_against_its_server(foreign, tmp_path, capsys):
    out, data = tmp_path / "plant.toml", tmp_path / "data"
    asked = ["connect", foreign(), "--out", str(out), "--data", str(data), "--watch", "2", "--yes"]
    assert run(asked) == 0
    assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0
    said = capsys.readouterr().out
    assert "Ventil_2.Q: " in said
    assert "hint" not in said
    text = out.read_text(encoding="utf-8")
    out.write_text(text.replace("tolerance_ms =", "tolerance_ms = 0 #"), encoding="utf-8")
    assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0
    assert "alignment.tolerance_ms = " in capsys.readouterr().out
    out.write_text(text.replace('p1 = { unit = "psi" }', ""), encoding="utf-8")
    assert run(["check-config", str(out), "--online"]) == 1
    assert "comes in psi, configured is bar: set unit = 'psi'" in capsys.readouterr().err
