"""asyncua is used, not patched: who else uses it in the process notices nothing of our server."""

import asyncio
import inspect
import logging
import sys
from asyncio.subprocess import PIPE
from importlib.metadata import version
from io import BytesIO

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.common.connection import SecureConnection
from asyncua.common.utils import Buffer
from asyncua.server.address_space import AddressSpace, AttributeValue
from asyncua.ua import ua_binary

from guarded_opcua import HardenedServer, ServerSettings
from support.raw_peer import RawPeer

pytestmark = pytest.mark.asyncio(loop_scope="module")

BEFORE_AND_AFTER = """
import asyncio, sys, asyncua, asyncua.server, asyncua.client
from asyncua.server import history, monitored_item_service, subscription_service, uaprocessor
from asyncua.crypto import uacrypto, validator
from asyncua.ua import ua_binary

def things():
    found = {}
    for name, module in sorted(sys.modules.items()):
        if name.split(".")[0] != "asyncua":
            continue
        for key, thing in vars(module).items():
            found[name, key] = id(thing)
            if isinstance(thing, type) and thing.__module__.startswith("asyncua"):
                parts = vars(thing).items()  # asyncua counts its sessions in a class
                found |= {(name, key, part): id(x) for part, x in parts if type(x) is not int}
    return found

kept = [vars(module).copy() for module in list(sys.modules.values())]  # so that no id is reused
before = things()

async def main():
    from guarded_opcua import HardenedServer, ServerSettings
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/", application_uri="urn:test:untouched",
        application_name="untouched", namespace_uri="urn:untouched", none_on_loopback=True,
    )
    server = await HardenedServer.create(settings)
    async with server, asyncua.Client(server.url) as client:
        await client.nodes.server_state.read_value()

asyncio.run(main())
after = things()
print([name for name, number in before.items() if after.get(name) != number])
"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server():
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/",
        application_uri="urn:test:untouched",
        application_name="untouched",
        namespace_uri="urn:untouched",
        none_on_loopback=True,
    )
    server = await HardenedServer.create(settings)
    async with server:
        yield server


async def test_asyncua_is_the_version_whose_private_parts_were_read():
    assert version("asyncua") == "2.1.0", "read the changes of asyncua, then raise this"


async def test_the_private_things_that_are_used_are_there():
    channel = SecureConnection.__init__.__code__.co_names
    assert {"_policies", "_limits", "security_policy"} <= set(channel)
    assert list(inspect.signature(SecureConnection.select_policy).parameters) == [
        "self",
        "uri",
        "peer_certificate",
        "mode",
    ]
    assert list(inspect.signature(SecureConnection.open).parameters) == ["self", "params", "server"]
    assert AddressSpace()._nodes == {}
    assert AttributeValue(ua.DataValue()).datachange_callbacks == {}


async def test_a_server_leaves_every_name_of_asyncua_as_it_was():
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", BEFORE_AND_AFTER, stdout=PIPE, stderr=PIPE
    )
    output, errors = await process.communicate()
    assert process.returncode == 0, errors.decode()
    assert output.decode().strip() == "[]"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (
            ua.Variant([[[], [], []], [[], [], []]], ua.VariantType.UInt32),
            [[[], [], []], [[], [], []]],
        ),
        (ua.Variant([1, 2, 3, 4, 5, 6], Dimensions=[2, 3]), [[1, 2, 3], [4, 5, 6]]),
    ],
)
async def test_others_decode_any_matrix_beside_the_server(server, value, expected):
    data = ua_binary.variant_to_binary(value)
    for source in (Buffer(data), BytesIO(data)):
        assert ua_binary.variant_from_binary(source).Value == expected


async def test_others_decode_a_node_from_a_stream_beside_the_server(server):
    node = ua.NodeId("valve", 2)
    assert ua_binary.nodeid_from_binary(BytesIO(ua_binary.nodeid_to_binary(node))) == node


async def test_others_decode_what_no_peer_may_send(server):
    data = bytes((ua.VariantType.Double | 0x80,)) + (200_000).to_bytes(4, "little")
    assert len(ua_binary.variant_from_binary(Buffer(data + bytes(1_600_000))).Value) == 200_000


async def test_others_lose_no_line_of_the_log(server, caplog):
    caplog.set_level(logging.WARNING, "asyncua")  # commands make it quieter
    peer = await RawPeer.connect(server.url)
    await peer.log_in()
    for _ in range(30):
        logging.getLogger("asyncua.uaprotocol").warning("of another %s", "client")
    peer.close()
    assert caplog.text.count("of another client") == 30
