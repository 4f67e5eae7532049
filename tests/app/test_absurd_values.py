"""Whatever an operator calls and writes, on either server: a status for each, and nothing ends.

Methods and writable nodes are found by browsing, so a new one is covered as soon as there is one.
"""

import asyncio
import logging
from functools import partial

import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import Role, ServerSettings, UserStore
from support.plant import plant
from support.results import results_settings
from support.served import patient
from support.users import CHEAP
from valvemap.config.estimators import build_estimator, default_estimators
from valvemap.errors import CommandRejected
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.server import RigServer

pytestmark = pytest.mark.asyncio(loop_scope="module")

PASSWORD = "correct horse"
NUMBERS = [
    *(0.0, 1e-300, -1e-300, 1e308, -1e308),
    *(float("nan"), float("inf"), float("-inf")),
]
TEXTS = ["", "x" * 10_000]
HUGE = ua.Variant("x" * 1_000_000, ua.VariantType.String)  # more than a request may have
TYPES = {
    ua.ObjectIds.Double: (ua.VariantType.Double, 1.0),
    ua.ObjectIds.Int32: (ua.VariantType.Int32, 1),
    ua.ObjectIds.UInt32: (ua.VariantType.UInt32, 1),
    ua.ObjectIds.String: (ua.VariantType.String, "demo"),
    ua.ObjectIds.LocalizedText: (ua.VariantType.LocalizedText, ua.LocalizedText("demo")),
    ua.ObjectIds.ByteString: (ua.VariantType.ByteString, b"demo"),
    ua.ObjectIds.Boolean: (ua.VariantType.Boolean, True),
}
AT_ONCE = 50  # nodes of a request
USUAL = {"kind": "damage", "name": "demo"}  # arguments of which few values are allowed
NO_ANSWER = {ua.StatusCodes.BadInternalError}


def operators():
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, PASSWORD)
    return users


@pytest.fixture(scope="module")
def identification():
    estimators = {
        one.name: build_estimator(one, (0.0, 100.0), (0.0, 200.0), (0.0, 200.0))
        for one in default_estimators()
    }
    plan = ValvePlan("Valvistor", QualityGate(), estimators, "Auto")
    known = Identification([plan], Alignment(AlignmentSettings(), (("T",),)))
    known.take_samples(0, plant(2_000))
    known.maps.refresh_all()
    return known


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def service(identification):
    settings = results_settings(users=operators(), none_on_loopback=True)
    server = ResultsServer(settings, identification.descriptions(), identification)
    async with server:
        await server.commissions.follow(["Valvistor"], NoRuns())
        await publish(server, identification)
        yield server


class NoRuns:
    """Fulfils `CommissionOperator`; nothing is driven."""

    def start_commission(self, valve, accuracy, user):
        assert 0.0 <= accuracy <= 10_000.0
        assert user

    def resume_commission(self, valve, accuracy, user):
        self.start_commission(valve, accuracy, user)

    def abort_commission(self, valve):
        raise CommandRejected(f"{valve}: no run is under way")

    def note_operator(self, valve):
        pass


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig():
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/rig/",
        application_uri="urn:test:valvemap:rig",
        application_name="valvemap rig",
        namespace_uri="urn:valvemap:rig",
        users=operators(),
        none_on_loopback=True,
    )
    async with await RigServer.create(settings, BUILTIN["demo"]) as server:
        playing = asyncio.create_task(server.run())
        yield server, playing
        playing.cancel()
        await asyncio.gather(playing, return_exceptions=True)


async def publish(server, known):
    for results in known.results.of([0]):
        await server.publish(results)


def as_operator(url):
    client = patient(url)
    client.set_user("operator")
    client.set_password(PASSWORD)
    return client


async def found_in(client):
    """Methods with their owners, and variables that the operator may write, below Objects."""
    methods, variables, level = [], [], [client.nodes.objects]
    seen = {level[0].nodeid}
    while level:
        below = []
        for owner, one in await references_from(client, level):
            if one.NodeClass == ua.NodeClass.Method:
                methods.append((owner, client.get_node(one.NodeId)))
            elif one.NodeId not in seen:
                seen.add(one.NodeId)
                below.append(one)
        level = [client.get_node(one.NodeId) for one in below]
        kinds = [one.NodeClass for one in below]
        values = [n for n, kind in zip(level, kinds, strict=True) if kind == ua.NodeClass.Variable]
        variables += await writable(client, values)
    by_name = sorted(methods, key=lambda pair: str(pair[1].nodeid))  # InjectFault before Stop…
    return by_name, variables


async def references_from(client, nodes):
    """The owner and the description of each node below some nodes."""
    below, to = ua.BrowseDirection.Forward, ua.NodeId(ua.ObjectIds.HierarchicalReferences)
    found = []
    for some in batched(nodes):
        asked = [
            ua.BrowseDescription(n.nodeid, below, to, ResultMask=ua.BrowseResultMask.All)
            for n in some
        ]
        answers = await client.uaclient.browse(ua.BrowseParameters(NodesToBrowse=asked))
        for owner, answer in zip(some, answers, strict=True):
            assert not answer.ContinuationPoint
            found += [(owner, one) for one in answer.References]
    return found


async def writable(client, nodes):
    """Those that the operator may write."""
    access = ua.AttributeIds.UserAccessLevel
    found = []
    for some in batched(nodes):
        answers = await client.uaclient.read_attributes([node.nodeid for node in some], access)
        levels = [(answer.Value and answer.Value.Value) or 0 for answer in answers]
        found += [node for node, level in zip(some, levels, strict=True) if level & 2]
    return found


def batched(nodes):
    return [nodes[k : k + AT_ONCE] for k in range(0, len(nodes), AT_ONCE)]


async def arguments_of(client, method):
    for one in await method.get_references(ua.ObjectIds.HasProperty, ua.BrowseDirection.Forward):
        if one.BrowseName.Name == "InputArguments":
            return await client.get_node(one.NodeId).read_value()
    return []


def absurd_values(data_type):
    """Values of this type, and the same as another one."""
    kind, _ = TYPES.get(data_type.Identifier, (ua.VariantType.Double, 1.0))
    for number in NUMBERS:
        yield ua.Variant(number, ua.VariantType.Double)
    for text in TEXTS:
        yield ua.Variant(text, ua.VariantType.String)
        if kind is ua.VariantType.LocalizedText:
            yield ua.Variant(ua.LocalizedText(text), kind)
        if kind is ua.VariantType.ByteString:
            yield ua.Variant(text.encode(), kind)
    if kind in (ua.VariantType.Int32, ua.VariantType.UInt32):
        yield from (ua.Variant(number, kind) for number in (0, 2**31 - 1))


def usual(argument):
    kind, value = TYPES.get(argument.DataType.Identifier, (ua.VariantType.Double, 1.0))
    return ua.Variant(USUAL.get(argument.Name, value), kind)


async def status_of(awaitable, what=None):
    """The StatusCode of an answer; anything else than an answer is raised."""
    try:
        await asyncio.wait_for(awaitable, 10.0)
    except ua.UaStatusCodeError as error:
        return error.code
    except ConnectionError as error:
        raise AssertionError(f"disconnected at {what}") from error
    return ua.StatusCodes.Good


async def is_too_large(url, request):
    """Whether a request is refused for its size; its connection is closed with that status."""
    async with as_operator(url) as another:
        try:
            await asyncio.wait_for(request(another), 10.0)
        except ConnectionError:
            return True
        except ua.UaStatusCodeError as error:
            return error.code == ua.StatusCodes.BadRequestTooLarge
    return False


async def huge_call(owner, method, given, client):
    await client.get_node(owner).call_method(client.get_node(method), *given)


async def huge_write(node, client):
    await client.get_node(node).write_value(ua.DataValue(HUGE))


async def attack(client):
    """Call every method and write every node; count requests, list those without an answer.

    Requests that are too large, calls before writes, are left to be made.
    """
    methods, variables = await found_in(client)
    bad, huge, count = [], [], 0

    async def note(what, variant, awaitable):
        nonlocal count
        count += 1
        code = await status_of(awaitable, (what, str(variant)[:80]))
        if code in NO_ANSWER:
            bad.append((what, str(variant)[:60], hex(code)))

    for owner, method in methods:
        arguments = await arguments_of(client, method)
        given = [usual(one) for one in arguments]
        await note(method, "", owner.call_method(method, *given))
        await note(method, "none", owner.call_method(method))
        for k, one in enumerate(arguments):
            for variant in absurd_values(one.DataType):
                changed = [*given[:k], variant, *given[k + 1 :]]
                await note(method, variant, owner.call_method(method, *changed))
        if arguments:
            call = partial(huge_call, owner.nodeid, method.nodeid, [*given[:-1], HUGE])
            huge.append(call)
    for node in variables:
        data_type = await node.read_data_type()
        for variant in absurd_values(data_type):
            await note(node, variant, node.write_value(ua.DataValue(variant)))
        huge.append(partial(huge_write, node.nodeid))
    return methods, variables, count, bad, huge


async def test_every_method_and_writable_node_of_the_service_answers_absurd_values(
    service, identification, caplog, capfd
):
    with caplog.at_level(logging.WARNING):
        async with as_operator(service.url) as client:
            methods, variables, count, bad, huge = await attack(client)
            identification.take_samples(0, plant(500, first=2_000))
            identification.maps.refresh_all()
            await publish(service, identification)
            assert await client.nodes.server_state.read_value() == 0
    a_call, *_, a_write = huge  # refused before it is known what it asks for
    assert await is_too_large(service.url, a_call)
    assert await is_too_large(service.url, a_write)
    assert len(methods) > 40
    assert len(variables) >= 2
    assert count > 300
    assert bad == []
    assert identification.failures.take_new() == []
    assert [record for record in caplog.records if record.exc_info] == []
    assert "Traceback" not in "".join(capfd.readouterr())


async def test_every_method_and_writable_node_of_the_rig_answers_absurd_values(rig, caplog, capfd):
    server, playing = rig
    with caplog.at_level(logging.WARNING):
        async with as_operator(server.url) as client:
            methods, variables, count, bad, huge = await attack(client)
            assert await client.nodes.server_state.read_value() == 0
    a_call, *_, a_write = huge
    assert await is_too_large(server.url, a_call)
    assert await is_too_large(server.url, a_write)
    assert len(methods) >= 3
    assert len(variables) >= 1
    assert count > 30
    assert bad == []
    assert not playing.done()
    assert [record for record in caplog.records if record.exc_info] == []
    assert "Traceback" not in "".join(capfd.readouterr())
