"""A client reads every attribute of every node, as it does at each click: no request is refused."""

from collections import Counter

import pytest
import pytest_asyncio
from asyncua import Client, ua

from support import go_peer, node_peer
from support.every_attribute import ATTRIBUTES, every_node, read_every
from support.own_servers import rig, service
from support.peer import Peer
from support.served import patient

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
Ids = ua.AttributeIds
Class = ua.NodeClass

# Part 3, 5.2 to 5.8: attributes of every node and of each class: mandatory, optional
BASE = ({Ids.NodeId, Ids.NodeClass, Ids.BrowseName, Ids.DisplayName}, {Ids.Description})
MASKS = {Ids.WriteMask, Ids.UserWriteMask, Ids.RolePermissions, Ids.UserRolePermissions}
MASKS |= {Ids.AccessRestrictions}
_OF_VARIABLES = {Ids.DataType, Ids.ValueRank}
OF_CLASS = {
    Class.Object: ({Ids.EventNotifier}, set()),
    Class.Variable: (
        {*_OF_VARIABLES, Ids.Value, Ids.AccessLevel, Ids.UserAccessLevel, Ids.Historizing},
        {Ids.ArrayDimensions, Ids.MinimumSamplingInterval, Ids.AccessLevelEx},
    ),
    Class.Method: ({Ids.Executable, Ids.UserExecutable}, set()),
    Class.ObjectType: ({Ids.IsAbstract}, set()),
    Class.VariableType: ({*_OF_VARIABLES, Ids.IsAbstract}, {Ids.Value, Ids.ArrayDimensions}),
    Class.ReferenceType: ({Ids.IsAbstract, Ids.Symmetric}, {Ids.InverseName}),
    Class.DataType: ({Ids.IsAbstract}, {Ids.DataTypeDefinition}),
    Class.View: ({Ids.ContainsNoLoops, Ids.EventNotifier}, set()),
}
ASKED_AT_ONCE = 500  # nodes that a program reads per line, each in a separate request
WITHOUT_DEFAULT = ua.NodeId(ua.ObjectIds.BaseDataVariableType)
PATIENCE_S = 60.0  # the server is in this process, and the machine may be busy
FAILED = (Codes.BadInternalError, Codes.BadEncodingError)


@pytest_asyncio.fixture(
    scope="module",
    loop_scope="module",
    params=[pytest.param(rig, marks=pytest.mark.node), service],
    ids=["rig", "service"],
)
async def url(request, tmp_path_factory):
    async with request.param(tmp_path_factory.mktemp("server")) as url:
        yield url


@pytest_asyncio.fixture(
    scope="module",
    loop_scope="module",
    params=[25, pytest.param(1, marks=pytest.mark.soak)],
    ids=["some of the standard's", "all"],
)
async def nodes(request, url):
    """All nodes of this server's own and of companions; of the standard's one in so many."""
    async with Client(url, timeout=PATIENCE_S, watchdog_intervall=PATIENCE_S) as client:
        found = await every_node(client)
    assert len(found) > 5_000
    standard = [id_ for id_ in found if not id_.NamespaceIndex and id_ != WITHOUT_DEFAULT]
    left_out = set(standard) - set(standard[:: request.param])
    yield [id_ for id_ in found if id_ not in left_out]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def read(url, nodes):
    async with Client(url, timeout=PATIENCE_S, watchdog_intervall=PATIENCE_S) as client:
        yield await read_every(client, nodes)


async def test_no_request_is_refused(nodes, read):
    assert read.faults == 0
    assert len(read.codes) == len(nodes) * len(ATTRIBUTES)


async def test_no_attribute_fails(read):
    assert [key for key, code in read.codes.items() if code in FAILED] == []


async def test_every_node_has_the_attributes_of_its_class_and_no_others(read):
    wrong = Counter()
    for (id_, attribute), code in read.codes.items():
        kind = read.classes[id_]
        must, may = OF_CLASS[kind]
        missing = code == Codes.BadAttributeIdInvalid
        if missing and attribute in {*BASE[0], *must}:
            wrong[kind, Ids(attribute), "missing"] += 1
        if not missing and attribute not in {*BASE[0], *BASE[1], *MASKS, *must, *may}:
            wrong[kind, Ids(attribute), "too many"] += 1
        if not missing and attribute != Ids.Value and (id_, attribute) in read.nulls:
            wrong[kind, Ids(attribute), "null"] += 1
    assert wrong == {}


async def test_the_value_of_a_variable_type_without_a_default_is_no_attribute_of_it(read):
    assert read.codes[WITHOUT_DEFAULT, Ids.Value] == Codes.BadAttributeIdInvalid


async def test_an_item_on_it_is_refused_with_the_same_reason(url):
    async with patient(url) as client:
        subscription = await client.create_subscription(100, None)
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await subscription.subscribe_data_change(client.get_node(WITHOUT_DEFAULT))
        assert refused.value.code == Codes.BadAttributeIdInvalid


@pytest.fixture(scope="module")
def node_opcua(request):
    return node_peer.program(request.config.cache.mkdir("node_peer"), "client.cjs")


@pytest.fixture(scope="module")
def gopcua():
    return go_peer.program()


async def counted(program, url, nodes):
    """What another stack finds: status codes by number, and faults."""
    peer = await Peer.start(*program)
    try:
        await peer.ask("connect", url=url)
        codes, faults = Counter(), 0
        for first in range(0, len(nodes), ASKED_AT_ONCE):
            batch = [id_.to_string() for id_ in nodes[first : first + ASKED_AT_ONCE]]
            found = await peer.ask("readEvery", nodes=batch, attributes=list(ATTRIBUTES))
            faults += len(found["faults"])
            codes.update({int(code): n for code, n in found["codes"].items()})
        await peer.ask("disconnect")
    finally:
        await peer.stop()
    return codes, faults


@pytest.mark.node
@pytest.mark.timeout(900)  # npm installs
async def test_node_opcua_finds_the_same(node_opcua, url, nodes, read):
    assert await counted(node_opcua, url, nodes) == (Counter(read.codes.values()), 0)


@pytest.mark.languages
@pytest.mark.timeout(900)  # go builds
async def test_gopcua_finds_the_same(gopcua, url, nodes, read):
    assert await counted(gopcua, url, nodes) == (Counter(read.codes.values()), 0)
