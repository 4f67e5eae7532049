"""A source server that lies: bounded memory, bounded time, one clear line, and another try."""

import struct
import time
import tracemalloc
from dataclasses import replace

import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import (
    HardenedServer,
    Pki,
    Role,
    ServerSettings,
    UserStore,
    add_object,
    add_variable,
    ensure_certificate,
)
from support.lying_server import Lie, LyingServer, chunk, frame
from support.users import CHEAP
from valvemap.errors import SourceError, SourceLost
from valvemap.opcua_client.session import BatchSession
from valvemap.opcua_client.source_errors import in_one_line
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_client.transport import BoundedClient
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.decoding import decode_data_changes
from valvemap.opcua_source.source_nodes import ValveNodes

pytestmark = [pytest.mark.waits, pytest.mark.asyncio(loop_scope="module")]

SECONDS = 1.0  # from a lie to the error
BYTES = 64 * 1024 * 1024  # at most 8 MiB of a message, and what is made of it
HUGE = 2**31 - 1
NODES = ValveNodes(
    "V1",
    *(f"nsu=urn:plant;s=V1.{n}" for n in ("U", "p1", "p2", "Q")),
    required_U="nsu=urn:plant;s=V1.Command",
)
IDS = ua.ObjectIds
ACKNOWLEDGE = 0
OPEN = IDS.OpenSecureChannelResponse_Encoding_DefaultBinary
READ = IDS.ReadResponse_Encoding_DefaultBinary
PUBLISH = IDS.PublishResponse_Encoding_DefaultBinary
GET_ENDPOINTS = IDS.GetEndpointsResponse_Encoding_DefaultBinary
WRITE = IDS.WriteResponse_Encoding_DefaultBinary
CLOSE = IDS.CloseSessionResponse_Encoding_DefaultBinary
SERVICES = [
    OPEN,
    GET_ENDPOINTS,
    IDS.CreateSessionResponse_Encoding_DefaultBinary,
    IDS.ActivateSessionResponse_Encoding_DefaultBinary,
    READ,
    IDS.CreateSubscriptionResponse_Encoding_DefaultBinary,
    IDS.CreateMonitoredItemsResponse_Encoding_DefaultBinary,
    PUBLISH,
    WRITE,
    CLOSE,
]
NAMES = {number: name.split("_")[0] for name, number in vars(IDS).items() if number in SERVICES}
UNTIL_DIAGNOSTICS = 4 + 8 + 4 + 4  # of a response: TypeId, time, handle, result
LITERAL = b"\1\0" + struct.pack("<H", IDS.LiteralOperand_Encoding_DefaultBinary) + b"\1"


def length(number):
    return struct.pack("<i", number)


def after_header(body, rest):
    """An honest header, and then what is no honest response."""
    return body[:UNTIL_DIAGNOSTICS] + b"\0" + length(-1) + bytes(3) + rest


def impossible_strings(body):
    return body[:UNTIL_DIAGNOSTICS] + b"\0" + length(HUGE)


def a_huge_string(body):
    return body[:UNTIL_DIAGNOSTICS] + b"\0" + length(1) + length(HUGE)


def many_strings(body):
    return body[:UNTIL_DIAGNOSTICS] + b"\0" + length(500_000) + length(-1) * 500_000


def nested_diagnostics(body):
    return body[:UNTIL_DIAGNOSTICS] + b"\x40" * 50_000


def nested_variants(body):
    inner = b"\0"
    for _ in range(2_000):
        content = b"\x16" + inner
        inner = LITERAL + length(len(content)) + content
    return body[:UNTIL_DIAGNOSTICS] + b"\0" + length(-1) + inner


def an_impossible_array(body):
    return after_header(body, length(HUGE))


def nothing(body):
    return b""


def a_fault_that_never_ends(body):
    head = b"\1\0" + struct.pack("<H", IDS.ServiceFault_Encoding_DefaultBinary)
    return impossible_strings(head + body[4:])


def another_response(body):
    kind = IDS.BrowseResponse_Encoding_DefaultBinary
    return b"\1\0" + struct.pack("<H", kind) + body[4:]


BODIES = [
    impossible_strings,
    a_huge_string,
    many_strings,
    nested_diagnostics,
    nested_variants,
    an_impossible_array,
    nothing,
    a_fault_that_never_ends,
    another_response,
]


def values(variant):
    """A ReadResponse of one value."""
    return lambda body: after_header(body, length(1) + b"\1" + variant + length(0))


def changes(record, count):
    """A PublishResponse that repeats a record."""

    def lie(body):
        records = length(count) + record * count + length(-1)
        kind = b"\1\0" + struct.pack("<H", IDS.DataChangeNotification_Encoding_DefaultBinary)
        message = struct.pack("<Iqi", 1, 0, 1) + kind + b"\1" + length(len(records)) + records
        subscription = body[24 + 4 : 24 + 8]
        return after_header(body, subscription + length(0) + b"\0" + message + length(0) * 2)

    return lie


READS = {
    "Nulls": values(b"\x80" + length(HUGE)),
    "a matrix without elements": values(
        b"\xc6" + length(0) + length(3) + length(HUGE) + length(HUGE) + length(0)
    ),
    "variants in variants": values(b"\x98\1\0\0\0" * 5_000 + b"\0"),
    "doubles": values(b"\x8b" + length(HUGE)),
    "small numbers": values(b"\x84" + length(900_000) + bytes(1_800_000)),
    "empty texts": values(b"\x95" + length(1_500_000) + bytes(1_500_000)),
    "no values": lambda body: after_header(body, length(0) + length(0)),
    "structures": values(b"\x96" + length(18_000) + (LITERAL + length(1) + b"\0") * 18_000),
}
PUBLISHED = {
    "changes without anything": changes(bytes(5), 1_500_000),
    "as many changes as are read": changes(bytes(5), 600_000),
    "structures": changes(bytes(4) + b"\1\x16" + bytes(3), 600_000),
    "empty texts": changes(bytes(4) + b"\1\x95" + length(50_000) + bytes(50_000), 150),
    "notifications": lambda body: after_header(
        body,
        body[28:32] + length(0) + b"\0" + struct.pack("<Iqi", 1, 0, 2_000_000) + bytes(6_000_000),
    ),
    "availability": lambda body: after_header(body, body[28:32] + length(HUGE)),
    "acknowledgements": lambda body: after_header(
        body,
        body[28:32]
        + length(0)
        + b"\0"
        + struct.pack("<Iqi", 1, 0, 0)
        + length(0)
        + length(5_000_000)
        + bytes(5_000_000),
    ),
}


def a_huge_frame(before):
    yield frame(before, b"", claimed=HUGE)
    for _ in range(1_600):
        yield bytes(65_536)


def a_tiny_frame(before):
    yield frame(before, b"", claimed=3)


def endless_chunks(before):
    return (chunk(before, bytes(60_000), i) for i in range(1_600))


def endless_empty_chunks(before):
    return (chunk(before, b"", i) for i in range(5_000))


def an_aborted_message(before):
    piece = chunk(before, struct.pack("<I", ua.StatusCodes.BadResponseTooLarge) + length(HUGE), 0)
    yield piece[:3] + b"A" + piece[4:]


def no_opc_ua(before):
    return (b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(1_000) for _ in range(100))


def an_error_that_never_ends(before):
    return (b"ERRF" + struct.pack("<I", HUGE) + bytes(65_536) for _ in range(100))


FRAMES = [
    a_huge_frame,
    a_tiny_frame,
    endless_chunks,
    endless_empty_chunks,
    an_aborted_message,
    no_opc_ua,
    an_error_that_never_ends,
]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def honest(tmp_path_factory):
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/plant/",
        application_uri="urn:test:plant",
        application_name="plant",
        namespace_uri="urn:plant",
        none_on_loopback=True,
        users=users,
    )
    server = await HardenedServer.create(settings)
    valve = await add_object(server, None, "V1")
    for name in ("U", "p1", "p2", "Q"):
        await add_variable(server, valve, f"V1.{name}", 1.0)
    await add_variable(server, valve, "V1.Command", 0.0, writable_by=Role.OPERATOR)
    decode_data_changes(bytes(4) + length(-1))  # compiles
    async with server:
        yield int(server.url.split(":")[2].split("/")[0]), password


@pytest_asyncio.fixture(loop_scope="module")
async def liar(honest):
    async with LyingServer(honest[0]) as liar:
        yield liar


@pytest.fixture
def settings(honest, liar):
    return SourceSettings(
        f"opc.tcp://127.0.0.1:{liar.port}/plant/",
        user="operator",
        password=honest[1],
        publishing_interval_ms=50.0,
        keep_alive_s=0.1,
        timeout_s=2.0,
    )


async def use(settings):
    """Use every service."""
    source = OpcUaSource(settings, [NODES])
    try:
        await source.connect()
        await source.write_required_U(0, 1.0)
        await source.receive()
    finally:
        await source.close()


async def failure(settings):
    try:
        await use(settings)
    except SourceError as error:
        return error
    return None


async def peak_of(settings):
    """Return the most memory that Python took meanwhile, bytes."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        await failure(settings)
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()


async def check(liar, settings, caplog, lie):
    liar.lie = lie
    error = await failure(settings)
    assert lie.told, "the lie was not told"
    assert time.monotonic() - lie.told < SECONDS
    if lie.kind != CLOSE:
        assert isinstance(error, SourceLost)
        assert str(error).startswith(settings.url)
        assert str(error).isprintable()
        assert len(str(error)) < 400
    assert await peak_of(settings) < BYTES
    assert not [line for line in caplog.records if line.exc_info]
    assert sum(len(line.getMessage()) for line in caplog.records) < 20_000
    liar.lie = None


async def connects_again(settings):
    source = OpcUaSource(settings, [NODES])
    await source.connect()
    assert len(await source.receive())
    await source.close()


@pytest.fixture
def secured(settings, tmp_path):
    pki = Pki(tmp_path)
    own = ensure_certificate(pki, "urn:test:client", ("localhost",), "client")
    return replace(settings, security=Security.BASIC256_SHA256, pki=pki, own=own)


def every_body_of_every_service():
    """Each body at a third of the services, each service with a third of the bodies; soak: all."""
    for i, kind in enumerate(SERVICES):
        for j, body in enumerate(BODIES):
            marks = pytest.mark.soak if (i + j) % 3 else ()
            yield pytest.param(kind, body, marks=marks, id=f"{NAMES[kind]}-{body.__name__}")


@pytest.mark.parametrize(("kind", "body"), [*every_body_of_every_service()])
async def test_no_response_of_any_service_costs_much(liar, settings, secured, caplog, kind, body):
    await check(liar, secured if kind == GET_ENDPOINTS else settings, caplog, Lie(kind, body))


@pytest.mark.parametrize("frames", FRAMES, ids=lambda lie: lie.__name__)
@pytest.mark.parametrize("kind", [ACKNOWLEDGE, OPEN, READ, PUBLISH], ids=str)
async def test_no_frame_is_kept_that_is_too_large(liar, settings, caplog, kind, frames):
    lie = Lie(kind, frames=frames)
    await check(liar, settings, caplog, lie)
    assert lie.bytes_taken < BYTES  # the pipes' buffers included


@pytest.mark.parametrize("body", READS.values(), ids=READS.keys())
async def test_no_value_that_is_read_costs_much(liar, settings, caplog, body):
    await check(liar, settings, caplog, Lie(READ, body))


@pytest.mark.parametrize("body", PUBLISHED.values(), ids=PUBLISHED.keys())
async def test_no_message_that_is_published_costs_much(liar, settings, caplog, body):
    await check(liar, settings, caplog, Lie(PUBLISH, body))


async def test_after_a_lie_the_next_try_finds_an_honest_server(liar, settings, caplog):
    for kind in (OPEN, READ, PUBLISH):
        await check(liar, settings, caplog, Lie(kind, nested_variants))
        await connects_again(settings)


async def test_a_service_whose_response_would_be_read_unbounded_is_not_asked_for():
    session = BatchSession(BoundedClient(1.0))
    with pytest.raises(NotImplementedError, match="AddNodesRequest"):
        await session.add_nodes([])


async def test_what_a_server_words_is_one_line():
    assert in_one_line("a\nb\x1b") == "a b "
    assert len(in_one_line("x" * 10_000)) < 400
