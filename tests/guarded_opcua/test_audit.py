"""Audit events: what security administrators hear, nobody else does, and nobody pays for."""

import asyncio
import time

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from guarded_opcua import (
    Argument,
    HardenedServer,
    Limits,
    Pki,
    Role,
    ServerSettings,
    UserStore,
    add_method,
    add_object,
    add_variable,
    ensure_certificate,
    trust,
)
from support import node_peer
from support.peer import Peer
from support.served import patient
from support.users import CHEAP

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes, Ids = ua.StatusCodes, ua.ObjectIds
PASSWORD = "correct horse"
PER_SECOND = 20.0
FIELDS = [
    "EventType",
    "SourceNode",
    "SourceName",
    "Message",
    "Severity",
    "Status",
    "ServerId",
    "ClientUserId",
    "SessionId",
    "ClientAuditEntryId",
    "StatusCodeId",
    "UserIdentityToken",
    "Certificate",
    "AttributeId",
    "OldValue",
    "NewValue",
    "MethodId",
    "InputArguments",
    "RevisedSessionTimeout",
]


async def until(condition, patience=3.0):
    async with asyncio.timeout(patience):
        while not condition():  # noqa: ASYNC110 - what comes over a socket sets no event
            await asyncio.sleep(0.02)


class Plant:
    """A server with something to write and something to call."""

    def __init__(self, server, folder):
        self.server, self.folder, self.errors = server, folder, 0

    async def populate(self):
        server = self.server
        self.object = await add_object(server, None, "Plant")
        self.demand = await add_variable(
            server, self.object, "Plant.Demand", 1.0, writable_by=Role.OPERATOR
        )
        self.method = await add_method(
            server,
            self.object,
            "Plant.Double",
            lambda x: 2 * x,
            inputs=[Argument("x")],
            outputs=[Argument("y")],
            required=Role.OBSERVER,
        )

    def client(self, user=None, password=PASSWORD):
        client = patient(self.server.url)
        client.application_uri = "urn:test:client"
        if user is not None:
            client.set_user(user)
            client.set_password(password)
        return client


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant(tmp_path_factory):
    folder = tmp_path_factory.mktemp("audit")
    users = UserStore(cost=CHEAP)
    for name, role in (("sara", Role.SECURITY_ADMIN), ("oskar", Role.OPERATOR)):
        users.add(name, role, PASSWORD)
    pki = Pki(folder / "server")
    own = ensure_certificate(Pki(folder / "client"), "urn:test:peer", ("localhost",), "peer")
    pki.make_folders()
    trust(pki, own.certificate)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/audit/",
        application_uri="urn:test:audit",
        application_name="audit",
        namespace_uri="urn:audit",
        pki=pki,
        users=users,
        none_on_loopback=True,
        limits=Limits(audit_events_per_second=PER_SECOND),
    )
    made = Plant(await HardenedServer.create(settings), folder)
    made.own = own
    await made.populate()
    async with made.server:
        yield made


def wish(where=None):
    def field(name):
        return ua.SimpleAttributeOperand(
            ua.NodeId(Ids.BaseEventType), [ua.QualifiedName(name)], ua.AttributeIds.Value, None
        )

    return ua.EventFilter([field(name) for name in FIELDS], where or ua.ContentFilter())


class Listening:
    """A client's subscription to the events of the server."""

    def __init__(self):
        self.events = []

    async def event_notification(self, event):
        self.events.append(event)

    def of(self, kind):
        return [event for event in self.events if event.EventType == ua.NodeId(kind)]

    async def heard(self, kind, more=lambda _: True):
        found = []

        def known():
            found[:] = [event for event in self.of(kind) if more(event)]
            return found

        await until(known)
        return found[-1]


async def listen(client):
    listening = Listening()
    subscription = await client.create_subscription(50, listening)
    await subscription.subscribe_events(Ids.Server, evfilter=wish())
    return listening


@pytest_asyncio.fixture(loop_scope="module")
async def sara(plant):
    async with plant.client("sara") as client:
        yield client


@pytest_asyncio.fixture(loop_scope="module")
async def listening(sara):
    return await listen(sara)


async def test_the_server_says_that_it_audits(sara):
    assert await sara.get_node(Ids.Server_Auditing).read_value() is True


async def test_an_opened_channel_and_a_cancelled_request_are_reported(plant, listening):
    async with plant.client("oskar") as client:
        opened = await listening.heard(Ids.AuditOpenSecureChannelEventType)
        assert opened.SourceName == "SecureChannel/OpenSecureChannel"
        request = ua.CancelRequest()
        request.Parameters.RequestHandle = 4711
        await client.uaclient.protocol.send_request(request)
        cancelled = await listening.heard(Ids.AuditCancelEventType)
        assert cancelled.SourceName == "Session/Cancel"
        assert cancelled.ClientUserId == "oskar"


async def test_sessions_are_told_from_their_beginning_to_their_end(plant, listening):
    async with plant.client("oskar"):
        pass
    closed = await listening.heard(Ids.AuditSessionEventType)
    created = listening.of(Ids.AuditCreateSessionEventType)[-1]
    activated = listening.of(Ids.AuditActivateSessionEventType)[-1]
    assert created.SessionId == activated.SessionId == closed.SessionId
    assert closed.SourceName == "Session/CloseSession"
    assert activated.ClientUserId == closed.ClientUserId == "oskar"
    assert activated.Status is True
    assert activated.ServerId == "urn:test:audit"
    assert activated.UserIdentityToken.UserName == "oskar"
    assert activated.UserIdentityToken.Password is None
    assert created.RevisedSessionTimeout > 0


async def test_a_wrong_password_is_told_without_the_password(plant, listening):
    with pytest.raises(ua.UaStatusCodeError):
        await plant.client("oskar", "wrong").connect()
    event = await listening.heard(Ids.AuditActivateSessionEventType, lambda found: not found.Status)
    assert event.StatusCodeId.value == Codes.BadUserAccessDenied
    assert event.UserIdentityToken.UserName == "oskar"
    assert event.UserIdentityToken.Password is None
    assert event.Severity == 500


async def test_a_refused_certificate_is_told_and_shown(plant, listening, tmp_path):
    own = ensure_certificate(Pki(tmp_path), "urn:test:stranger", ("localhost",), "stranger")
    client = plant.client("oskar")
    client.application_uri = "urn:test:stranger"
    await client.set_security(SecurityPolicyBasic256Sha256, str(own.certificate), str(own.key))
    with pytest.raises((ua.UaError, ConnectionError, TimeoutError)):
        await client.connect()
    event = await listening.heard(Ids.AuditCertificateUntrustedEventType)
    assert event.Certificate == own.certificate.read_bytes()
    assert event.StatusCodeId.value == Codes.BadCertificateUntrusted


async def test_a_write_is_told_with_its_values_whether_taken_or_refused(plant, listening):
    async with plant.client("oskar") as oskar, plant.client() as anybody:
        node = oskar.get_node(plant.demand.id)
        before = await node.read_value()
        await node.write_value(7.5)
        event = await listening.heard(Ids.AuditWriteUpdateEventType)
        assert (event.OldValue, event.NewValue) == (before, 7.5)
        assert event.SourceNode == plant.demand.id
        assert (event.ClientUserId, event.Status) == ("oskar", True)
        assert event.AttributeId == ua.AttributeIds.Value
        with pytest.raises(ua.UaStatusCodeError):
            await anybody.get_node(plant.demand.id).write_value(1.0)
        event = await listening.heard(Ids.AuditWriteUpdateEventType, lambda found: not found.Status)
        assert event.StatusCodeId.value == Codes.BadUserAccessDenied
        assert event.ClientUserId == "anonymous"


async def test_a_call_is_told_with_its_arguments(plant, listening):
    async with plant.client("oskar") as oskar:
        await oskar.get_node(plant.object).call_method(plant.method, 21.0)
    event = await listening.heard(Ids.AuditUpdateMethodEventType)
    assert event.MethodId == plant.method
    assert event.SourceNode == plant.object
    assert [argument.Value for argument in event.InputArguments] == [21.0]


async def test_what_the_client_calls_the_request_is_told(plant, listening):
    async with plant.client("oskar") as oskar:
        request = ua.WriteRequest()
        request.RequestHeader.AuditEntryId = "shift 7"
        request.Parameters.NodesToWrite = [
            ua.WriteValue(
                plant.demand.id, ua.AttributeIds.Value, None, ua.DataValue(ua.Variant(7.5))
            )
        ]
        await oskar.uaclient.protocol.send_request(request)
    event = await listening.heard(Ids.AuditWriteUpdateEventType)
    assert event.ClientAuditEntryId == "shift 7"


@pytest.mark.parametrize("user", [None, "oskar"])
async def test_nobody_but_a_security_administrator_hears_of_it(plant, listening, user):
    async with plant.client(user) as client, plant.client("oskar") as oskar:
        eavesdropping = await listen(client)
        await oskar.get_node(plant.demand.id).write_value(8.5)
        event = await listening.heard(Ids.AuditWriteUpdateEventType)
        assert event.NewValue == 8.5
        await asyncio.sleep(0.2)
        assert eavesdropping.events == []


async def test_who_logs_in_as_somebody_else_hears_no_more(plant):
    client = plant.client("sara")
    await client.connect()
    listening = await listen(client)
    await client.activate_session()  # anonymously, in the same session
    count = len(listening.events)
    async with plant.client("oskar"):
        await asyncio.sleep(0.2)
    assert len(listening.events) <= count + 1
    await client.disconnect()


async def test_a_value_too_large_to_keep_is_left_out(plant, listening):
    async with plant.client() as anybody:
        with pytest.raises(ua.UaStatusCodeError):
            await anybody.get_node(plant.demand.id).write_value([0.5] * 50_000)
    event = await listening.heard(Ids.AuditWriteUpdateEventType, lambda found: not found.Status)
    assert event.NewValue is None


async def test_a_flood_of_refusals_is_told_in_part_and_costs_little(plant, listening):
    lost = plant.server.counters.lost_notifications
    async with plant.client() as anybody:
        wrong = ua.WriteValue(
            plant.demand.id, ua.AttributeIds.Value, None, ua.DataValue(ua.Variant(1.0))
        )
        request, began = ua.WriteParameters([wrong] * 1_000), time.monotonic()
        refused, answered = [], []
        for _ in range(3):
            refused.append(await processor_time(anybody.uaclient.write(request)))
            reading = [plant.demand.id] * 1_000, ua.AttributeIds.Value
            answered.append(await processor_time(anybody.uaclient.read_attributes(*reading)))
        assert min(refused) < 10.0 * min(answered)
        await asyncio.sleep(0.3)
        events = len(listening.of(Ids.AuditWriteUpdateEventType))
        covered = PER_SECOND * (5.0 + time.monotonic() - began) + 1
        assert events <= covered
        assert plant.server.counters.lost_notifications - lost >= 3_000 - covered
        await asyncio.sleep(0.2)
        with pytest.raises(ua.UaStatusCodeError):
            await anybody.get_node(plant.demand.id).write_value(1.0)
    await listening.heard(
        Ids.AuditWriteUpdateEventType, lambda event: "left out" in event.Message.Text
    )


async def processor_time(request):
    spent = time.process_time()
    await request
    return time.process_time() - spent


async def test_a_filter_of_audit_events_passes_those_derived_from_them(plant, sara):
    listening = Listening()
    subscription = await sara.create_subscription(50, listening)
    kind = ua.LiteralOperand(ua.Variant(ua.NodeId(Ids.AuditUpdateEventType)))
    where = ua.ContentFilter([ua.ContentFilterElement(ua.FilterOperator.OfType, [kind])])
    await subscription.subscribe_events(Ids.Server, evfilter=wish(where))
    async with plant.client("oskar") as oskar:
        await oskar.get_node(plant.demand.id).write_value(3.0)
    await listening.heard(Ids.AuditWriteUpdateEventType)
    assert listening.of(Ids.AuditCreateSessionEventType) == []
    await subscription.delete()


@pytest.mark.node
async def test_node_opcua_receives_them(plant, request, tmp_path):
    cache = request.config.cache.mkdir("node_peer")
    peer = await Peer.start(*node_peer.program(cache, "client.cjs"))
    try:
        await peer.ask(
            "connect",
            url=plant.server.url,
            policy="Basic256Sha256",
            user="sara",
            password=PASSWORD,
            certificate=str(plant.own.certificate),
            key=str(plant.own.key),
            applicationUri="urn:test:peer",
            pki=str(tmp_path),
        )
        fields = ["EventType", "Message", "ClientUserId", "OldValue", "NewValue"]
        await peer.ask("listen", node="i=2253", fields=fields, kind="AuditEventType")
        async with plant.client("oskar") as oskar:
            await oskar.get_node(plant.demand.id).write_value(9.25)
        events = []
        while not any(event["NewValue"] == 9.25 for event in events):
            await asyncio.sleep(0.1)
            events += await peer.ask("events")
        (event,) = [event for event in events if event["NewValue"] == 9.25]
        assert event["ClientUserId"] == "oskar"
        assert "Plant.Demand" in event["Message"]
        await peer.ask("disconnect")
    finally:
        await peer.stop()
