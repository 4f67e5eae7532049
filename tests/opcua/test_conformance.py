"""docs/conformance.md says what the servers do: read its tables, ask a server, compare."""

import ast
import json
import re
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import encrypt_asymmetric
from asyncua.ua import ua_binary

from documentation.companions import KEPT, PARTS, NodeSet
from guarded_opcua import (
    Argument,
    HardenedServer,
    Pki,
    Records,
    Role,
    ServerSettings,
    Unit,
    UserStore,
    add_method,
    add_object,
    add_variable,
)
from support.raw_peer import Closed, RawPeer
from support.results import results_settings
from support.users import CHEAP
from valvemap.opcua_results.results_server import ResultsServer

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
HERE = Path(__file__).parent
PAGE = (HERE.parents[1] / "docs" / "conformance.md").read_text(encoding="utf-8")
POLICY = "http://opcfoundation.org/UA/SecurityPolicy#"
PROFILE = "http://opcfoundation.org/UA-Profile/Server/"
VALUE = ua.AttributeIds.Value


def table(first_column):
    """Return the rows of the page's table whose head begins so, a dict each."""
    lines = PAGE.splitlines()
    start = next(n for n, line in enumerate(lines) if line.startswith(f"| {first_column} |"))
    head, _, *rest = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[start:]]
    rows = rest[: next(n for n, cells in enumerate(rest) if not cells)]
    return [dict(zip(head, cells, strict=True)) for cells in rows]


def plain(text):
    return text.strip("`")


SERVICES = {row["service"]: row["answer"] for row in table("set")}
FILTERS = {row["filter"]: row["answer"] for row in table("filter")}
LIMITS = {plain(row["node"]): int(row["value"]) for row in table("node")}


def settings(**more):
    return ServerSettings(
        url="opc.tcp://127.0.0.1:0/conformance/",
        application_uri="urn:test:conformance",
        application_name="conformance",
        namespace_uri="urn:conformance",
        **more,
    )


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    made = await HardenedServer.create(settings(none_on_loopback=True, users=users))
    made.password = password
    folder = await add_object(made, None, "Plant")
    made.flow = await add_variable(
        made, folder, "Plant.Flow", 1.0, unit=Unit.LITRE_PER_MINUTE, value_range=(0.0, 200.0)
    )
    made.count = await add_variable(made, folder, "Plant.Count", 1, type=ua.VariantType.UInt32)
    made.demand = await add_variable(
        made, folder, "Plant.Demand", 1.0, value_range=(0.0, 9.0), writable_by=Role.OPERATOR
    )
    made.text = await add_variable(made, folder, "Plant.Text", "x", type=ua.VariantType.String)
    made.folder = folder
    made.method = await add_method(
        made,
        folder,
        "Plant.Double",
        lambda x: 2 * x,
        inputs=[Argument("x")],
        outputs=[Argument("y")],
        required=Role.OBSERVER,
    )
    made.add_history([made.flow], Remembered())
    made.add_event_history([folder], NothingHappened(), ["EventId", "Time"])
    made.keep_conditions(Nothing())
    async with made:
        yield made


class Remembered:
    """Fulfils Historian: two values, of now and of then."""

    def raw(self, variable, span, skip, most):
        at = np.array([span.low, span.high])
        return Records(np.ones(2), np.zeros(2, np.uint32), at, at)


class NothingHappened:
    """Fulfils EventHistorian: there are no events."""

    async def events(self, emitter, span, skip, most):
        return []


@pytest_asyncio.fixture(loop_scope="module")
async def peer(server):
    peer = await RawPeer.connect(server.url)
    await peer.open()
    session = await peer.create_session()
    key = uacrypto.x509_from_der(session.ServerCertificate).public_key()
    secret = ua_binary.Primitives.Bytes.pack(server.password.encode() + session.ServerNonce)
    password, algorithm = encrypt_asymmetric(key, secret, f"{POLICY}Basic256Sha256")
    await peer.activate(ua.UserNameIdentityToken("username", "operator", password, algorithm))
    yield peer
    peer.close()


class Nothing:
    """Fulfils ConditionKeeper: there are no conditions."""

    def find(self, condition):
        return None

    def retained(self):
        return iter(())


class Idle:
    """As much of an Operator as a service without valves needs."""

    def alarms(self, valve):
        return ()


class Asker:
    """Asks for each service in a way that should succeed where the service is supported."""

    def __init__(self, server, peer):
        self.server, self.peer = server, peer

    async def ask(self, service):
        """Return the codes of the service and of its operations."""
        prepare = getattr(self, f"_{service}", None)
        request = getattr(ua, f"{service}Request")()
        if prepare is not None:
            await prepare(request)
        response = await self.peer.call(request, getattr(ua, f"{service}Response"))
        codes = [response.ResponseHeader.ServiceResult]
        for results in (response, getattr(response, "Parameters", None)):
            codes += [code_of(result) for result in getattr(results, "Results", None) or []]
        return {code.name for code in codes}

    async def subscription(self):
        request = ua.CreateSubscriptionRequest()
        request.Parameters = ua.CreateSubscriptionParameters(50.0, 1_000, 10, 0, True, 0)  # noqa: FBT003
        made = await self.peer.call(request, ua.CreateSubscriptionResponse)
        return made.Parameters.SubscriptionId

    async def item(self, subscription, filter_=None, variable=None):
        request = ua.CreateMonitoredItemsRequest()
        item = item_of(variable or self.server.flow, filter_)
        request.Parameters = ua.CreateMonitoredItemsParameters(
            subscription, ua.TimestampsToReturn.Both, [item]
        )
        (made,) = (await self.peer.call(request, ua.CreateMonitoredItemsResponse)).Results
        return made

    async def _CloseSession(self, request):
        request.DeleteSubscriptions = True

    async def _Browse(self, request):
        request.Parameters.NodesToBrowse = [ua.BrowseDescription(NodeId=self.server.folder)]

    async def _BrowseNext(self, request):
        first = ua.BrowseRequest()
        first.Parameters.RequestedMaxReferencesPerNode = 1
        await self._Browse(first)
        (result,) = (await self.peer.call(first, ua.BrowseResponse)).Results
        request.Parameters.ContinuationPoints = [result.ContinuationPoint]

    async def _TranslateBrowsePathsToNodeIds(self, request):
        name = ua.QualifiedName("Plant", self.server.namespace_index)
        element = ua.RelativePathElement(ua.NodeId(33), False, True, name)  # noqa: FBT003
        path = ua.BrowsePath(ua.NodeId(85), ua.RelativePath([element]))
        request.Parameters.BrowsePaths = [path]

    async def _RegisterNodes(self, request):
        request.Parameters.NodesToRegister = [self.server.flow.id]

    async def _UnregisterNodes(self, request):
        request.Parameters.NodesToUnregister = [self.server.flow.id]

    async def _Read(self, request):
        request.Parameters.NodesToRead = [ua.ReadValueId(self.server.flow.id, VALUE)]

    async def _Write(self, request):
        value = ua.DataValue(ua.Variant(2.0), StatusCode=None)
        request.Parameters.NodesToWrite = [ua.WriteValue(self.server.demand.id, VALUE, Value=value)]

    async def _HistoryRead(self, request):
        request.Parameters.ReleaseContinuationPoints = False
        request.Parameters.HistoryReadDetails = ua.ReadRawModifiedDetails(
            IsReadModified=False, NumValuesPerNode=1
        )
        request.Parameters.NodesToRead = [ua.HistoryReadValueId(self.server.flow.id)]

    async def _Call(self, request):
        call = ua.CallMethodRequest(self.server.folder, self.server.method, [ua.Variant(1.0)])
        request.Parameters.MethodsToCall = [call]

    async def _CreateMonitoredItems(self, request):
        request.Parameters = ua.CreateMonitoredItemsParameters(
            await self.subscription(), ua.TimestampsToReturn.Both, [item_of(self.server.flow)]
        )

    async def _ModifyMonitoredItems(self, request):
        subscription = await self.subscription()
        made = await self.item(subscription)
        wish = ua.MonitoringParameters(1, 0.0, None, 5, True)  # noqa: FBT003
        change = ua.MonitoredItemModifyRequest(made.MonitoredItemId, wish)
        request.Parameters = ua.ModifyMonitoredItemsParameters(
            subscription, ua.TimestampsToReturn.Both, [change]
        )

    async def _SetMonitoringMode(self, request):
        subscription = await self.subscription()
        made = await self.item(subscription)
        mode = ua.MonitoringMode.Sampling
        request.Parameters = ua.SetMonitoringModeParameters(
            subscription, mode, [made.MonitoredItemId]
        )

    async def _SetTriggering(self, request):
        subscription = await self.subscription()
        one, other = [(await self.item(subscription)).MonitoredItemId for _ in range(2)]
        request.Parameters = ua.SetTriggeringParameters(subscription, one, [other], [])

    async def _DeleteMonitoredItems(self, request):
        subscription = await self.subscription()
        made = await self.item(subscription)
        request.Parameters = ua.DeleteMonitoredItemsParameters(subscription, [made.MonitoredItemId])

    async def _ModifySubscription(self, request):
        request.Parameters.SubscriptionId = await self.subscription()

    async def _SetPublishingMode(self, request):
        request.Parameters.PublishingEnabled = True
        request.Parameters.SubscriptionIds = [await self.subscription()]

    async def _Publish(self, _):
        await self.subscription()

    async def _Republish(self, request):
        subscription = await self.subscription()
        await self.item(subscription)
        published = await self.peer.call(ua.PublishRequest(), ua.PublishResponse)
        number = published.Parameters.NotificationMessage.SequenceNumber
        request.Parameters = ua.RepublishParameters(subscription, number)

    async def _TransferSubscriptions(self, request):
        request.Parameters.SubscriptionIds = [await self.subscription()]

    async def _DeleteSubscriptions(self, request):
        request.Parameters.SubscriptionIds = [await self.subscription()]


def item_of(variable, filter_=None):
    wish = ua.MonitoringParameters(1, 0.0, filter_, 10, True)  # noqa: FBT003
    wanted = ua.ReadValueId(variable.id, VALUE)
    return ua.MonitoredItemCreateRequest(wanted, ua.MonitoringMode.Reporting, wish)


def code_of(result):
    return result if isinstance(result, ua.StatusCode) else result.StatusCode or ua.StatusCode()


async def test_the_page_names_every_service_of_the_standard():
    ending = "Request_Encoding_DefaultBinary"
    known = {name.removesuffix(ending) for name in dir(ua.ObjectIds) if name.endswith(ending)}
    structures = {"CallMethod", "MonitoredItemCreate", "MonitoredItemModify"}
    assert set(SERVICES) == known - structures


@pytest.mark.parametrize("service", [name for name in SERVICES if "SecureChannel" not in name])
async def test_a_service_answers_as_the_page_says(server, peer, service):
    answer = SERVICES[service]
    try:
        found = await Asker(server, peer).ask(service)
    except ua.UaStatusCodeError as error:
        found = {ua.StatusCode(error.code).name}
    expected = answer.removeprefix("each operation ")
    assert found == ({expected, "Good"} if expected != answer else {expected})


async def test_a_channel_is_opened_renewed_and_closed(server):
    assert (SERVICES["OpenSecureChannel"], SERVICES["CloseSecureChannel"]) == ("Good", "Good")
    peer = await RawPeer.connect(server.url)
    await peer.open()
    request = ua.OpenSecureChannelRequest()
    request.Parameters.RequestType = ua.SecurityTokenRequestType.Renew
    request.Parameters.SecurityMode = ua.MessageSecurityMode.None_
    data = ua_binary.struct_to_binary(request)
    peer.writer.write(peer.channel.message_to_binary(data, ua.MessageType.SecureOpen, 2))
    body = (await peer.receive()).body()
    renewed = ua_binary.struct_from_binary(ua.OpenSecureChannelResponse, body)
    assert renewed.Parameters.SecurityToken.ChannelId == peer.channel.security_token.ChannelId
    assert renewed.Parameters.SecurityToken.TokenId != peer.channel.security_token.TokenId
    peer.send(ua.CloseSecureChannelRequest())
    with pytest.raises(Closed):
        await peer.receive()
    peer.close()


@pytest.mark.parametrize("described", FILTERS)
async def test_a_filter_is_taken_as_the_page_says(server, peer, described):
    triggers = {trigger.name: trigger for trigger in ua.DataChangeTrigger}
    kind, _, rest = described.partition(", ")
    match kind:
        case "AggregateFilter":
            wish = ua.AggregateFilter()
        case "EventFilter on a variable":
            wish = ua.EventFilter()
        case _ if "deadband" in rest:
            wish = ua.DataChangeFilter(
                Trigger=ua.DataChangeTrigger.StatusValue,
                DeadbandType=ua.DeadbandType[rest.split()[0]].value,
                DeadbandValue=5.0,
            )
        case _:
            wish = ua.DataChangeFilter(Trigger=triggers[rest])
    variable = server.flow
    if "text" in rest:
        variable = server.text
    elif "without EURange" in rest:
        variable = server.count
    asker = Asker(server, peer)
    made = await asker.item(await asker.subscription(), wish, variable)
    assert made.StatusCode.name == FILTERS[described]


@pytest.mark.parametrize(
    ("name", "answer"),
    [
        ("GetMonitoredItems", "Good"),
        ("ResendData", "Good"),
        ("SetSubscriptionDurable", "BadNodeIdUnknown"),
        ("RequestServerStateChange", "BadNodeIdUnknown"),
    ],
)
async def test_a_method_of_the_server_object_answers_as_the_page_says(server, peer, name, answer):
    assert f"`{name}`" in PAGE
    subscription = await Asker(server, peer).subscription()
    inputs = [ua.Variant(subscription, ua.VariantType.UInt32)]
    method = ua.NodeId(getattr(ua.ObjectIds, f"Server_{name}"))
    request = ua.CallRequest()
    request.Parameters.MethodsToCall = [
        ua.CallMethodRequest(ua.NodeId(ua.ObjectIds.Server), method, inputs)
    ]
    (result,) = (await peer.call(request, ua.CallResponse)).Results
    assert result.StatusCode.name == answer


async def test_profiles_are_announced_as_the_page_says(peer):
    (announced,) = await values_of(peer, ["Server_ServerCapabilities_ServerProfileArray"])
    rows = table("profile or facet")
    assert set(announced) == {
        PROFILE + plain(row["URI"]) for row in rows if row["announced"] == "yes"
    }


async def test_what_remembers_events_says_which_fields_of_them(server, peer):
    request = ua.BrowseRequest()
    has_property = ua.NodeId(ua.ObjectIds.HasProperty)
    wanted = ua.BrowseDescription(server.folder, ReferenceTypeId=has_property, ResultMask=63)
    request.Parameters.NodesToBrowse = [wanted]
    (found,) = (await peer.call(request, ua.BrowseResponse)).Results[0].References
    assert found.BrowseName == ua.QualifiedName("HistoricalEventFilter")
    (kept,) = await values_of(peer, ["HistoricalEventFilter"])
    assert [clause.BrowsePath[0].Name for clause in kept.SelectClauses] == ["EventId", "Time"]


async def test_models_of_others_are_there_as_the_page_says(peer):
    (here,) = await values_of(peer, ["Server_NamespaceArray"])
    async with ResultsServer(results_settings(none_on_loopback=True), (), Idle()) as service:
        other = await RawPeer.connect(service.url)
        await other.open()
        await other.create_session()
        await other.activate(ua.AnonymousIdentityToken("anonymous"))
        (there,) = await values_of(other, ["Server_NamespaceArray"])
        other.close()
    rows = table("model or type")
    models = {plain(row["URI or id"]): row for row in rows if "http" in row["URI or id"]}
    assert [row["there"] for row in models.values()] == ["in part"] * len(PARTS)
    assert all(
        row["what is there instead"].startswith("at the service:") for row in models.values()
    )
    assert not models.keys() & {*here}
    assert {*there} >= models.keys()
    for part in PARTS:
        (said,) = NodeSet((KEPT / part.kept).read_text(encoding="utf-8")).models()
        (row,) = (row for uri, row in models.items() if uri == said.get("ModelUri"))
        assert row["model or type"].endswith(said.get("Version"))
    events = {plain(row["URI or id"]): row["there"] for row in rows if "i=" in row["URI or id"]}
    assert events == {
        f"i={ua.ObjectIds.GeneralModelChangeEventType}": "yes",
        f"i={ua.ObjectIds.SemanticChangeEventType}": "no",
    }
    for node_set in (
        "service/valvemap/opcua_results/valvemap.NodeSet2.xml",
        "virtual_rig/valvemap_rig/rig.NodeSet2.xml",
    ):
        text = (HERE.parents[1] / node_set).read_text(encoding="utf-8")
        assert "NodeVersion" not in text
        assert not any(uri in text for uri in models)


async def test_limits_are_announced_as_the_page_says(peer):
    names = [f"Server_ServerCapabilities_{name.replace('.', '_')}" for name in LIMITS]
    assert dict(zip(LIMITS, await values_of(peer, names), strict=True)) == LIMITS


async def test_five_hundred_items_fit_into_each_of_five_subscriptions(server, peer):
    asker = Asker(server, peer)
    numbers = {number for number in vars(ua.ObjectIds).values() if isinstance(number, int)}
    nodes = [ua.NodeId(number) for number in sorted(numbers)]
    nodes = [node for node in nodes if node in server.ua.iserver.aspace][:500]
    items = [
        ua.MonitoredItemCreateRequest(
            ua.ReadValueId(node, ua.AttributeIds.BrowseName),
            ua.MonitoringMode.Reporting,
            ua.MonitoringParameters(number, 0.0, None, 5, True),  # noqa: FBT003
        )
        for number, node in enumerate(nodes)
    ]
    for _ in range(5):
        request = ua.CreateMonitoredItemsRequest()
        request.Parameters = ua.CreateMonitoredItemsParameters(
            await asker.subscription(), ua.TimestampsToReturn.Both, items
        )
        made = (await peer.call(request, ua.CreateMonitoredItemsResponse)).Results
        assert {item.StatusCode.name for item in made} == {"Good"}
        assert {item.RevisedQueueSize for item in made} == {5}


async def test_endpoints_are_offered_as_the_page_says(server, peer, tmp_path):
    rows = table("security policy")
    on_demo = {
        (plain(row["security policy"]), row["mode"]) for row in rows if "demo," in row["offered"]
    }
    always = {
        (plain(row["security policy"]), row["mode"]) for row in rows if "always" in row["offered"]
    }
    assert shown(await endpoints(peer)) == on_demo
    secured = await HardenedServer.create(settings(pki=Pki(tmp_path)))
    async with secured:
        stranger = await RawPeer.connect(secured.url)
        await stranger.open()
        offered = await endpoints(stranger)
        assert shown(offered) == always
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await stranger.create_session()
        assert refused.value.code == Codes.BadSecurityPolicyRejected
        stranger.close()
    tokens = {plain(row["user token"]): row["offered"] for row in table("user token")}
    everywhere = {name for name, where in tokens.items() if where == "always"}
    for endpoint in offered:
        assert {token.TokenType.name for token in endpoint.UserIdentityTokens} == everywhere
    (endpoint,) = await endpoints(peer)
    assert {token.TokenType.name for token in endpoint.UserIdentityTokens} == set(tokens)


async def test_what_the_page_calls_to_witness_is_there():
    witnesses = re.findall(r"`(test_\w+\.py)::(\w+)`", PAGE)
    assert len(witnesses) >= 15
    for file, name in witnesses:
        trees = [ast.parse(at.read_text("utf-8")) for at in HERE.parent.glob(f"*/{file}")]
        there = {getattr(node, "name", None) for tree in trees for node in tree.body}
        assert name in there, f"{file}::{name}"


async def test_the_versions_of_other_stacks_are_those_of_the_tests():
    versions = {row["stack"]: row["version"] for row in table("stack")}
    package = json.loads((HERE / "node_peer" / "package.json").read_text(encoding="utf-8"))
    milo = (HERE / "milo_client" / "pom.xml").read_text(encoding="utf-8")
    assert package["dependencies"]["node-opcua-client"].startswith(versions["node-opcua"])
    assert f"<version>{versions['Eclipse Milo']}</version>" in milo
    assert metadata.version("asyncua").startswith(versions["asyncua"])


async def values_of(peer, names):
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [
        ua.ReadValueId(ua.NodeId(getattr(ua.ObjectIds, name)), VALUE) for name in names
    ]
    response = await peer.call(request, ua.ReadResponse)
    return [value.Value.Value for value in response.Results]


async def endpoints(peer):
    return (await peer.call(ua.GetEndpointsRequest(), ua.GetEndpointsResponse)).Endpoints


def shown(offered):
    return {
        (endpoint.SecurityPolicyUri.removeprefix(POLICY), endpoint.SecurityMode.name.rstrip("_"))
        for endpoint in offered
    }
