"""A source's own units: turned into ours, and refused where they contradict the configuration."""

import asyncio

import numpy as np
import pytest
import pytest_asyncio
from asyncua import Server, ua

from valvemap.app.connections import build_source
from valvemap.config.loading import load_config
from valvemap.errors import SourceRejected
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.units import UNECE, Measure, unit_of

pytestmark = pytest.mark.asyncio(loop_scope="module")

URI = "urn:test:units"
NODES = {"U": "AO", "p1": "P1", "p2": "P2", "Q": "FT", "T": "TT"}
MEASURES = {
    "U": Measure(raw=(4.0, 20.0), scaled=(0.0, 100.0)),
    "p1": Measure(unit=unit_of("psi")),
    "p2": Measure(unit=unit_of("kPa")),
    "Q": Measure(unit=unit_of("gpm")),
    "T": Measure(unit=unit_of("degF")),
}
PORTS = {"U": "AO", "pP": "P2", "pA": "P1", "QA": "FT", "pT": "Tank", "T": "TT"}
PORT_UNITS = {
    "U": "{ raw = [4, 20], range = [-100, 100] }",
    "pP": '{ unit = "kPa" }',
    "pA": '{ unit = "psi" }',
    "QA": '{ unit = "gpm" }',
    "T": '{ unit = "°F" }',
}
VALUES = {"AO": 12.0, "P1": 1000.0, "P2": 500.0, "FT": 10.0, "TT": 104.0}
INSIDE = [50.0, 68.947572931683613, 5.0, 37.85411784, 40.0]


def information(code, symbol):
    number = int.from_bytes(code.encode(), "big")
    return ua.EUInformation(UNECE, number, ua.LocalizedText(symbol), ua.LocalizedText(symbol))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def url():
    """A server of another make, as far as its units go."""
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/units/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace(URI)
    of_node = {
        "AO": (information("4K", "mA"), ua.Range(4.0, 20.0)),
        "P1": (information("PS", "psi"), ua.Range(0.0, 3000.0)),
        "P2": (ua.EUInformation("", -1, ua.LocalizedText("kPa")), None),
        "FT": (information("G2", "gal (US) /min"), None),
        "TT": (information("FAH", "°F"), None),
        "Tank": (None, None),
        "Bare": (None, ua.Range(0.0, 10.0)),
        "Volume": (information("LTR", "l"), None),
    }
    for name, (unit, bounds) in of_node.items():
        node = await server.nodes.objects.add_variable(
            ua.NodeId(name, index), name, VALUES.get(name, 1.0), ua.VariantType.Double
        )
        await node.set_writable()
        if unit is not None:
            await node.add_property(0, "EngineeringUnits", unit)
        if bounds is not None:
            await node.add_property(0, "EURange", bounds)
    async with server:
        port = server.bserver._server.sockets[0].getsockname()[1]
        yield f"opc.tcp://127.0.0.1:{port}/units/"


def source(url, measures, *, insist=False, required_U=None, **other):
    nodes = {name: f"nsu={URI};s={last}" for name, last in {**NODES, **other}.items()}
    command = None if required_U is None else f"nsu={URI};s={required_U}"
    valve = ValveNodes("V7", **nodes, required_U=command, measures=measures, insist=insist)
    return OpcUaSource(SourceSettings(url, timeout_s=5.0), [valve])


async def first_values(source):
    await source.connect()
    try:
        found = {}
        async with asyncio.timeout(10):
            while len(found) < 5:
                changes = await source.receive()
                found |= dict(zip(changes.item.tolist(), changes.value.tolist(), strict=True))
        return [found[item] for item in range(5)]
    finally:
        await source.close()


async def test_psi_gpm_ma_and_fahrenheit_arrive_in_our_units(url):
    np.testing.assert_allclose(await first_values(source(url, MEASURES)), INSIDE, rtol=1e-15)


@pytest.mark.parametrize(
    ("change", "other", "said"),
    [
        ({"p1": Measure()}, {}, "comes in psi, configured is bar: set unit = 'psi'"),
        ({"p2": Measure(unit=unit_of("psi"))}, {}, "comes in kPa, configured is psi: set unit"),
        ({"U": Measure()}, {}, "comes in mA: raw and range must say what it means"),
        (
            {"U": Measure(raw=(0.0, 27648.0), scaled=(0.0, 100.0))},
            {},
            "has the range [4, 20], configured is raw = [0.0, 27648.0]",
        ),
        (
            {"p1": Measure(raw=(4.0, 20.0), scaled=(0.0, 250.0))},
            {},
            "comes in psi, configured is a raw range: leave raw and range out",
        ),
        ({}, {"Q": "TT"}, "comes in °F, a unit of temperature; is it the right node?"),
        (
            {"U": Measure()},
            {"U": "Bare"},
            "has the range [0, 10], which is no %: raw = [0, 10], range = [0, 100]",
        ),
    ],
)
async def test_a_node_that_says_otherwise_is_refused_by_name(url, change, other, said):
    refused = source(url, MEASURES | change, **other)
    with pytest.raises(SourceRejected) as caught:
        await refused.connect()
    assert said in str(caught.value)
    assert str(caught.value).startswith("node 'nsu=urn:test:units;s=")
    insisting = source(url, MEASURES | change, insist=True, **other)
    await insisting.connect()
    await insisting.close()


async def test_a_unit_that_is_not_in_the_table_is_no_contradiction(url):
    await first_values(source(url, MEASURES | {"Q": Measure()}, Q="Volume"))


async def test_a_command_is_written_in_its_own_unit(url):
    command = Measure(raw=(0.0, 10.0), scaled=(0.0, 100.0))
    feeding = source(url, MEASURES | {"required_U": command}, required_U="Bare")
    await feeding.connect()
    await feeding.write_required_U(0, 25.0)
    await feeding.close()
    plain = MEASURES | {"U": Measure(raw=(0.0, 10.0), scaled=(0.0, 10.0))}
    assert (await first_values(source(url, plain, U="Bare")))[0] == 2.5


async def test_every_signal_that_reads_a_node_is_compared_with_it(url):
    nodes = {name: f"nsu={URI};s={last}" for name, last in NODES.items()}
    first = ValveNodes("V6", **nodes, measures=MEASURES)
    second = ValveNodes("V7", **nodes, measures=MEASURES | {"T": Measure()})
    shared = OpcUaSource(SourceSettings(url, timeout_s=5.0), [first, second])
    with pytest.raises(SourceRejected, match=r"\(T of valve V7\) comes in °F, configured is °C"):
        await shared.connect()


async def test_a_valve_with_ports_is_compared_by_the_names_of_its_ports(url, tmp_path):
    def configured(**signals):
        node = {name: f'"nsu={URI};s={last}"' for name, last in PORTS.items()}
        nodes = "\n".join(f"{name} = {text}" for name, text in node.items())
        units = "\n".join(f"{name} = {text}" for name, text in (PORT_UNITS | signals).items())
        file = tmp_path / "ports.toml"
        file.write_text(
            f'[source]\nurl = "{url}"\nsecurity = "None"\n[[valves]]\nname = "Boom"\n'
            f"[valves.ports]\n{nodes}\n[valves.ports.signals]\n{units}\n",
            encoding="utf-8",
        )
        return build_source(load_config(file))

    await configured().check()
    with pytest.raises(SourceRejected) as caught:
        await configured(U="{}", pA="{}").check()
    assert str(caught.value) == (
        "node 'nsu=urn:test:units;s=AO' (U of valve Boom) comes in mA: raw and range must say what "
        "it means (signals.U of valve Boom; insist = true takes it as it is) (and 1 more nodes)"
    )
    with pytest.raises(SourceRejected, match=r"\(signals.pA of valve Boom;.*as it is\)$"):
        await configured(pA="{}").check()
