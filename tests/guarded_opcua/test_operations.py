"""An unexpected failure in one operation of a request is the status of that operation alone."""

import asyncio
import datetime as dt

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua import (
    Argument,
    HardenedServer,
    Records,
    Role,
    ServerSettings,
    UserStore,
    add_method,
    add_object,
    add_variable,
)
from guarded_opcua.sessions.operations import answer_each
from support.served import patient
from support.users import CHEAP

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
Ids = ua.AttributeIds
PASSWORD = "correct horse"
SINCE = dt.datetime(2000, 1, 1, tzinfo=dt.UTC)
_BOTH = ua.BrowseDirection.Both
LONE = "\ud800"  # a surrogate that UTF-8 cannot hold
WRONG = {
    "text for a number": ua.Variant("x", ua.VariantType.Int32),
    "too large a number": ua.Variant(2**40, ua.VariantType.Byte),
    "a lone surrogate": ua.Variant(LONE, ua.VariantType.String),
    "an object of no type": ua.Variant(object(), ua.VariantType.ExtensionObject),
    "text in an array": ua.Variant([1.0, "x"], ua.VariantType.Double, is_array=True),
}


class Broken(Exception):  # noqa: N818 - thrown, not shown
    """Something that no operation expects."""


class Past:
    """Fulfils Historian: the variable named Broken has a past that cannot be read."""

    def raw(self, variable, span, skip, most):
        if variable.Identifier.endswith("Broken"):
            raise Broken
        return Records(np.ones(1), np.zeros(1, np.uint32), np.ones(1, int), np.ones(1, int))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server():
    users = UserStore(cost=CHEAP)
    users.add("olga", Role.OPERATOR, PASSWORD)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/operations/",
        application_uri="urn:test:operations",
        application_name="operations",
        namespace_uri="urn:operations",
        users=users,
        none_on_loopback=True,
    )
    made = await HardenedServer.create(settings)
    plant = await add_object(made, None, "Plant")
    for name in ("Good", "Broken"):
        wrong = {"writable_by": Role.OPERATOR, "value_range": (0.0, 9.0)}
        variable = await add_variable(made, plant, f"Plant.{name}", 1.0, **wrong)
        made.add_history([variable], Past())
        made.__dict__[name.lower()] = variable
    for name in WRONG:
        await add_variable(made, plant, f"Plant.{name}", 1.0)
    for name, outcome in (("Whole", 1.0), ("Odd", "x")):
        await add_method(
            made,
            plant,
            f"Plant.{name}",
            lambda outcome=outcome: outcome,
            outputs=[Argument("y")],
            required=Role.OBSERVER,
        )
    async with made:
        yield made


@pytest_asyncio.fixture(loop_scope="module")
async def client(server):
    client = patient(server.url)
    client.set_user("olga")
    client.set_password(PASSWORD)
    async with client:
        yield client


@pytest.fixture
def broken(server, monkeypatch):
    """Reading the attributes of the variable named Broken fails, whatever asks for them."""
    read = server.address_space.read_attribute_value

    def fail(id_, attribute):
        if id_ == server.broken.id:
            raise Broken
        return read(id_, attribute)

    monkeypatch.setattr(server.address_space, "read_attribute_value", fail)


def id_of(server, name):
    return ua.NodeId(f"Plant.{name}", server.namespace_index)


def hold(server, name):
    """Have a variable hold a value that cannot be encoded."""
    held = server.address_space[id_of(server, name)].attributes[Ids.Value]
    times = held.value.SourceTimestamp, held.value.ServerTimestamp
    held.value = ua.DataValue(WRONG[name], ua.StatusCode(), *times)


async def read(client, *ids, attribute=Ids.Value):
    params = ua.ReadParameters(
        TimestampsToReturn=ua.TimestampsToReturn.Both,
        NodesToRead=[ua.ReadValueId(id_, attribute) for id_ in ids],
    )
    return await client.uaclient.read(params)


@pytest.mark.parametrize("name", WRONG)
async def test_a_value_that_cannot_be_encoded_is_the_only_one_that_is_not_read(
    server, client, name
):
    hold(server, name)
    before, odd, after = await read(client, server.good.id, id_of(server, name), server.good.id)
    assert before.Value.Value == after.Value.Value == 1.0
    assert odd.StatusCode.value == Codes.BadEncodingError
    assert odd.Value.Value is None


async def test_an_attribute_that_cannot_be_read_is_the_only_one(server, client, broken):
    odd, good = await read(client, server.broken.id, server.good.id)
    assert odd.StatusCode.value == Codes.BadInternalError
    assert good.Value.Value == 1.0


async def test_a_write_that_fails_is_the_only_one(server, client, broken):
    value = ua.DataValue(ua.Variant(2.0, ua.VariantType.Double))
    wanted = [ua.WriteValue(v.id, Ids.Value, None, value) for v in (server.broken, server.good)]
    codes = await client.uaclient.write(ua.WriteParameters(wanted))
    assert [code.value for code in codes] == [Codes.BadInternalError, Codes.Good]


async def test_a_call_whose_outputs_cannot_be_encoded_is_the_only_one_that_fails(server, client):
    plant = ua.NodeId("Plant", server.namespace_index)
    wanted = [ua.CallMethodRequest(plant, id_of(server, name)) for name in ("Odd", "Whole")]
    odd, whole = await client.uaclient.call(wanted)
    assert odd.StatusCode.is_bad()
    assert whole.OutputArguments[0].Value == 1.0


async def test_a_past_that_cannot_be_read_is_the_only_one(server, client):
    details = ua.ReadRawModifiedDetails(
        StartTime=SINCE, EndTime=SINCE + dt.timedelta(1), IsReadModified=False, NumValuesPerNode=1
    )
    params = ua.HistoryReadParameters(
        HistoryReadDetails=details,
        ReleaseContinuationPoints=False,
        NodesToRead=[ua.HistoryReadValueId(v.id) for v in (server.broken, server.good)],
    )
    odd, good = await client.uaclient.history_read(params)
    assert odd.StatusCode.value == Codes.BadInternalError
    assert good.StatusCode.is_good()


async def test_a_node_that_cannot_be_browsed_is_the_only_one(server, client, monkeypatch):
    odd = server.address_space[server.broken.id]
    one = ua.ReferenceDescription(BrowseName=ua.QualifiedName(LONE))
    monkeypatch.setattr(odd, "references", [one])
    params = ua.BrowseParameters(
        NodesToBrowse=[
            ua.BrowseDescription(NodeId=id_, ResultMask=63, BrowseDirection=_BOTH)
            for id_ in (server.broken.id, ua.NodeId("Plant", server.namespace_index))
        ]
    )
    found = await client.uaclient.browse(params)
    assert found[0].StatusCode.value == Codes.BadInternalError
    assert len(found[1].References) > 2


async def test_a_path_that_cannot_be_followed_is_the_only_one(server, client, monkeypatch):
    monkeypatch.setattr(server.address_space[server.broken.id], "references", [None])
    name = ua.QualifiedName("Good", server.namespace_index)
    element = ua.RelativePathElement(IsInverse=False, TargetName=name)
    plant = ua.NodeId("Plant", server.namespace_index)
    paths = [
        ua.BrowsePath(start, ua.RelativePath([element])) for start in (server.broken.id, plant)
    ]
    odd, good = await client.uaclient.translate_browsepaths_to_nodeids(paths)
    assert odd.StatusCode.value == Codes.BadInternalError
    assert good.Targets[0].TargetId == server.good.id


class Seen:
    """The values that a subscription brings, as far as ``count`` nodes."""

    def __init__(self, count):
        self.values, self.count, self.complete = {}, count, asyncio.Event()

    def datachange_notification(self, node, _, data):
        self.values[node.nodeid.Identifier] = data.monitored_item.Value
        if len(self.values) == self.count:
            self.complete.set()


async def test_an_item_that_cannot_be_made_is_the_only_one(server, client, broken):
    subscription = await client.create_subscription(50, Seen(1))
    nodes = [client.get_node(v.id) for v in (server.broken, server.good)]
    odd, good = await subscription.subscribe_data_change(nodes)
    assert odd.value == Codes.BadInternalError
    assert isinstance(good, int)
    await subscription.delete()


async def test_a_value_that_cannot_be_encoded_is_published_as_its_status(server, client):
    hold(server, "text for a number")
    seen = Seen(2)
    subscription = await client.create_subscription(10, seen)
    names = ("text for a number", "Good")
    await subscription.subscribe_data_change(
        [client.get_node(id_of(server, name)) for name in names]
    )
    async with asyncio.timeout(5.0):
        await seen.complete.wait()
    await subscription.delete()
    assert seen.values["Plant.text for a number"].StatusCode.value == Codes.BadEncodingError
    assert seen.values["Plant.Good"].StatusCode.is_good()


async def breathe():
    pass


def refusal(code):
    return code.to_bytes(4, "little")


async def test_each_operation_has_a_result_in_its_place():
    async def answer(number):
        if number == 1:
            raise Broken
        if number == 2:
            raise ua.UaStatusCodeError(Codes.BadNoData)
        return bytes((number,))

    found = await answer_each(range(4), answer, refusal, breathe, 100)
    assert found == [b"\0", refusal(Codes.BadInternalError), refusal(Codes.BadNoData), b"\3"]


async def test_what_refuses_the_request_refuses_all_of_it():
    async def answer(_):
        raise ServiceError(Codes.BadSubscriptionIdInvalid)

    with pytest.raises(ServiceError):
        await answer_each([1], answer, refusal, breathe, 100)


async def test_results_beyond_the_bound_are_refused():
    async def answer(_):
        return bytes(60)

    with pytest.raises(ServiceError) as refused:
        await answer_each([1, 2], answer, refusal, breathe, 100)
    assert refused.value.code == Codes.BadResponseTooLarge
