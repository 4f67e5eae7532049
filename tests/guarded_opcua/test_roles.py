"""Who may do what, on every endpoint: the whole table."""

import asyncio
import itertools
import threading

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.crypto.security_policies import (
    SecurityPolicyAes256Sha256RsaPss,
    SecurityPolicyBasic256,
    SecurityPolicyBasic256Sha256,
)

from guarded_opcua import (
    Argument,
    CommandRejected,
    HardenedServer,
    InvalidArgument,
    OutOfRange,
    Pki,
    Role,
    ServerSettings,
    Unit,
    UserStore,
    add_method,
    add_object,
    add_variable,
    ensure_certificate,
    rejected,
    trust,
)
from guarded_opcua.address_space.role_permissions import ROLE_IDS
from support.served import patient
from support.users import CHEAP

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
PASSWORD = "correct horse"
ROLES = {
    None: Role.OBSERVER,
    "olga": Role.OBSERVER,
    "oskar": Role.OPERATOR,
    "erna": Role.ENGINEER,
    "sara": Role.SECURITY_ADMIN,
}
ENDPOINTS = {
    "None": None,
    "Basic256Sha256": SecurityPolicyBasic256Sha256,
    "Aes256Sha256RsaPss": SecurityPolicyAes256Sha256RsaPss,
}


class Plant:
    """A server with a node for each right."""

    def __init__(self, server, pki, own):
        self.server, self.pki, self.own = server, pki, own
        self.written = []
        self.refuse = None

    async def populate(self):
        server = self.server
        self.folder = await add_object(server, None, "Plant")
        self.level = await add_variable(
            server, self.folder, "Plant.Level", 1.0, unit=Unit.PERCENT, value_range=(0, 100)
        )
        self.command = {
            role: await add_variable(
                server,
                self.folder,
                f"Plant.Command{role.name.title()}",
                1.0,
                value_range=(0, 100),
                writable_by=role,
                on_write=self.take,
            )
            for role in Role
        }
        self.method = {
            role: await add_method(
                server,
                self.folder,
                f"Plant.Do{role.name.title()}",
                self.do,
                inputs=[
                    Argument("a", "A number", unit=Unit.BAR, value_range=(0, 10)),
                    Argument("text", "Some text", type=ua.VariantType.String),
                ],
                outputs=[Argument("twice", "2 a"), Argument("text", type=ua.VariantType.String)],
                required=role,
                description="Doubles",
            )
            for role in Role
        }

    def take(self, value):
        if self.refuse:
            raise self.refuse
        self.written.append(value)

    async def do(self, a, text):
        await asyncio.sleep(0)
        if self.refuse:
            raise self.refuse
        return 2 * a, text

    async def client(self, endpoint="None", user=None, password=PASSWORD):
        client = patient(self.server.url)
        client.application_uri = "urn:test:client"
        policy = ENDPOINTS.get(endpoint, endpoint)
        if policy is not None:
            await client.set_security(policy, str(self.own.certificate), str(self.own.key))
        if user is not None:
            client.set_user(user)
            client.set_password(password)
        return client


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pki")
    pki = Pki(folder / "server")
    own = ensure_certificate(Pki(folder / "client"), "urn:test:client", ("localhost",), "client")
    trust(pki, own.certificate)
    users = UserStore(cost=CHEAP)
    for name, role in ROLES.items():
        if name is not None:
            users.add(name, role, PASSWORD)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/plant/",
        application_uri="urn:test:plant",
        application_name="plant",
        namespace_uri="urn:plant",
        pki=pki,
        users=users,
        none_on_loopback=True,
    )
    made = Plant(await HardenedServer.create(settings), pki, own)
    await made.populate()
    async with made.server:
        yield made


@pytest_asyncio.fixture(loop_scope="module")
async def observer(plant):
    async with await plant.client() as client:
        yield client


@pytest_asyncio.fixture(loop_scope="module")
async def operator(plant):
    async with await plant.client(user="oskar") as client:
        yield client


async def code_of(awaitable):
    try:
        await awaitable
    except ua.UaStatusCodeError as error:
        return error.code
    return Codes.Good


@pytest.mark.parametrize(("endpoint", "user"), list(itertools.product(ENDPOINTS, ROLES)))
async def test_every_role_may_do_just_what_it_may_on_every_endpoint(plant, endpoint, user):
    role = ROLES[user]
    plant.refuse = None
    async with await plant.client(endpoint, user) as client:
        level = client.get_node(plant.level.id)
        assert await level.read_value() == 1.0
        assert await code_of(level.write_value(2.0)) == Codes.BadNotWritable
        assert await code_of(level.write_attribute(ua.AttributeIds.DisplayName, _text())) == (
            Codes.BadNotWritable
        )
        status = client.get_node(ua.ObjectIds.Server_ServerStatus_State)
        assert await code_of(status.write_value(ua.DataValue(ua.Variant(1)))) == (
            Codes.BadNotWritable
        )
        for needed in Role:
            allowed = role >= needed
            right = Codes.Good if allowed else Codes.BadUserAccessDenied
            variable = client.get_node(plant.command[needed].id)
            assert await code_of(variable.write_value(50.0)) == right
            access = await variable.get_user_access_level()
            assert (ua.AccessLevel.CurrentWrite in access) == allowed
            assert ua.AccessLevel.CurrentWrite in await variable.get_access_level()
            method = client.get_node(plant.method[needed])
            call = client.get_node(plant.folder).call_method(method.nodeid, 1.0, "x")
            assert await code_of(call) == right
            executable = await method.read_attribute(ua.AttributeIds.UserExecutable)
            assert executable.Value.Value == allowed
        children = await client.get_node(plant.folder).get_children()
        assert client.get_node(plant.level.id) in children
        history = client.get_node(plant.level.id).read_raw_history(numvalues=1)
        assert await code_of(history) == Codes.BadHistoryOperationUnsupported
        added = client.get_node(plant.folder).add_variable(2, "New", 1.0)
        assert await code_of(added) == Codes.BadServiceUnsupported
        gone = client.delete_nodes([client.get_node(plant.level.id)])
        assert await code_of(gone) == Codes.BadServiceUnsupported
        subscription = await client.create_subscription(100, _Ignore())
        await subscription.subscribe_data_change(level)
        await subscription.delete()


async def test_no_standard_node_is_writable(plant):
    aspace = plant.server._inside.aspace
    open_ = [
        nodeid
        for nodeid in aspace.keys()  # noqa: SIM118 - asyncua's address space is no mapping
        if nodeid.NamespaceIndex == 0
        and (held := aspace[nodeid].attributes.get(ua.AttributeIds.AccessLevel)) is not None
        and held.value.Value.Value & (1 << ua.AccessLevel.CurrentWrite)
    ]
    assert open_ == []


@pytest.mark.parametrize("endpoint", ENDPOINTS)
@pytest.mark.parametrize(
    ("user", "password"),
    [("oskar", "wrong"), ("oskar", ""), ("admin", "admin"), (" ", "x"), ("nobody", PASSWORD)],
)
async def test_a_wrong_user_or_password_is_let_in_nowhere(plant, endpoint, user, password):
    client = await plant.client(endpoint, user, password)
    code = await code_of(client.connect())
    assert code in (Codes.BadUserAccessDenied, Codes.BadIdentityTokenInvalid)
    await client.disconnect()
    plant.server.settings.users.unlock(user)


@pytest.mark.parametrize("endpoint", ENDPOINTS)
async def test_a_user_may_log_in_with_a_certificate_of_his_own(plant, tmp_path, endpoint):
    known, stranger = (
        ensure_certificate(Pki(tmp_path / name), f"urn:{name}", ("localhost",), name)
        for name in ("carl", "stranger")
    )
    users = plant.server.settings.users
    users.add_certificate("carl", Role.ENGINEER, known.certificate.read_bytes())
    for shown, key, code in (
        (known, known, Codes.Good),
        (stranger, stranger, Codes.BadUserAccessDenied),
        (known, stranger, Codes.BadUserSignatureInvalid),
    ):
        client = await plant.client(endpoint)
        await client.load_client_certificate(str(shown.certificate))
        await client.load_private_key(str(key.key))
        assert await code_of(client.connect()) == code
        if code == Codes.Good:
            variable = client.get_node(plant.command[Role.ENGINEER].id)
            assert await code_of(variable.write_value(1.0)) == Codes.Good
        await client.disconnect()
    users.remove("carl")


async def test_guessing_locks_the_user_for_this_peer(plant):
    for _ in range(5):
        client = await plant.client(user="erna", password="wrong")
        assert await code_of(client.connect()) == Codes.BadUserAccessDenied
        await client.disconnect()
    client = await plant.client(user="erna")
    assert await code_of(client.connect()) == Codes.BadUserAccessDenied
    await client.disconnect()
    plant.server.settings.users.unlock("erna")
    async with await plant.client(user="erna"):
        pass


async def test_the_session_goes_on_while_another_guesses(plant, observer, monkeypatch):
    users, answered, went_on = plant.server.settings.users, threading.Event(), []
    authenticate = users.authenticate

    def authenticate_once_another_is_answered(*guess):
        answered.clear()
        went_on.append(answered.wait(10.0))
        return authenticate(*guess)

    monkeypatch.setattr(users, "authenticate", authenticate_once_another_is_answered)

    async def guess():
        client = await plant.client(user="oskar", password="wrong")
        await code_of(client.connect())
        await client.disconnect()

    guessing = asyncio.gather(*(guess() for _ in range(8)))
    while not guessing.done():
        await observer.get_node(plant.level.id).read_value()
        answered.set()
        await asyncio.sleep(0.01)
    await guessing
    users.unlock("oskar")
    assert went_on
    assert all(went_on)


async def test_an_endpoint_that_is_not_offered_cannot_be_used(plant):
    client = patient(plant.server.url)
    client.application_uri = "urn:test:client"
    offered = await client.connect_and_get_server_endpoints()
    policies = {(e.SecurityPolicyUri.split("#")[1], e.SecurityMode.name) for e in offered}
    assert policies == {
        ("None", "None_"),
        ("Basic256Sha256", "SignAndEncrypt"),
        ("Aes256_Sha256_RsaPss", "SignAndEncrypt"),
    }
    assert SecurityPolicyBasic256.URI not in {e.SecurityPolicyUri for e in offered}


async def test_an_unknown_certificate_is_refused_and_kept_for_the_administrator(plant, tmp_path):
    own = ensure_certificate(Pki(tmp_path), "urn:test:stranger", ("localhost",), "stranger")
    client = patient(plant.server.url)
    client.application_uri = "urn:test:stranger"
    await client.set_security(SecurityPolicyBasic256Sha256, str(own.certificate), str(own.key))
    with pytest.raises((ua.UaError, ConnectionError, TimeoutError)):
        await client.connect()
    (kept,) = rejected(plant.pki)
    assert kept.read_bytes() == own.certificate.read_bytes()
    trust(plant.pki, kept.stem[:10])
    async with client:
        assert await client.get_node(plant.level.id).read_value() == 1.0


async def test_a_certificate_must_name_the_application_that_shows_it(plant):
    client = await plant.client("Basic256Sha256")
    client.application_uri = "urn:test:somebody-else"
    assert await code_of(client.connect()) == Codes.BadCertificateUriInvalid
    await client.disconnect()


async def test_the_certificate_of_the_session_must_be_that_of_the_channel(plant, monkeypatch):
    for shown in (None, b"", b"other"):
        client = await plant.client("Basic256Sha256")
        create = client.uaclient.create_session

        async def lie(params, shown=shown, create=create):
            params.ClientCertificate = shown
            return await create(params)

        monkeypatch.setattr(client.uaclient, "create_session", lie)
        assert await code_of(client.connect()) == Codes.BadSecurityChecksFailed
        await client.disconnect()


async def test_methods_check_number_type_range_and_finiteness(plant, observer):
    folder, method = observer.get_node(plant.folder), plant.method[Role.OBSERVER]
    assert await folder.call_method(method, 2.5, "x") == [5.0, "x"]
    for arguments, code in (
        ((), Codes.BadArgumentsMissing),
        ((1.0,), Codes.BadArgumentsMissing),
        ((1.0, "x", 1.0), Codes.BadTooManyArguments),
        (("x", "x"), Codes.BadInvalidArgument),
        ((1, "x"), Codes.BadInvalidArgument),
        (([1.0], "x"), Codes.BadInvalidArgument),
        ((11.0, "x"), Codes.BadInvalidArgument),
        ((float("nan"), "x"), Codes.BadInvalidArgument),
        ((float("inf"), "x"), Codes.BadInvalidArgument),
    ):
        assert await code_of(folder.call_method(method, *arguments)) == code


async def test_a_refused_argument_is_told_from_the_others(plant, observer):
    request = ua.CallMethodRequest(
        plant.folder,
        plant.method[Role.OBSERVER],
        [ua.Variant(11.0), ua.Variant("x", ua.VariantType.String)],
    )
    (result,) = await observer.uaclient.call([request])
    codes = [code.value for code in result.InputArgumentResults]
    assert codes == [Codes.BadOutOfRange, Codes.Good]


@pytest.mark.parametrize(
    ("refusal", "code"),
    [
        (CommandRejected("not now"), Codes.BadInvalidState),
        (OutOfRange("too far"), Codes.BadOutOfRange),
        (InvalidArgument(1, "no such text"), Codes.BadInvalidArgument),
        (RuntimeError("a bug"), Codes.BadInternalError),
    ],
)
async def test_what_a_method_raises_becomes_a_status_code(plant, observer, refusal, code):
    plant.refuse = refusal
    call = observer.get_node(plant.folder).call_method(plant.method[Role.OBSERVER], 1.0, "x")
    assert await code_of(call) == code
    plant.refuse = None


async def test_a_method_is_called_on_its_object_only(plant, observer):
    wrong = observer.nodes.server.call_method(plant.method[Role.OBSERVER], 1.0, "x")
    assert await code_of(wrong) == Codes.BadMethodInvalid
    unknown = observer.get_node(plant.folder).call_method(ua.NodeId("Nothing", 2))
    assert await code_of(unknown) == Codes.BadNodeIdUnknown
    refresh = observer.nodes.server.call_method(
        ua.NodeId(ua.ObjectIds.Server_SetSubscriptionDurable)
    )
    assert await code_of(refresh) == Codes.BadNodeIdUnknown  # what is not offered is not there


async def test_arguments_have_names_types_units_and_descriptions(plant, observer):
    method = observer.get_node(plant.method[Role.OBSERVER])
    arguments = await (await method.get_child("0:InputArguments")).read_value()
    assert [argument.Name for argument in arguments] == ["a", "text"]
    assert arguments[0].DataType == ua.NodeId(ua.ObjectIds.Double)
    assert arguments[0].Description.Text == "A number [bar] (0 to 10)"
    assert (await method.read_description()).Text == "Doubles"


@pytest.mark.parametrize(
    ("value", "code"),
    [
        (100.0, Codes.Good),
        (100.1, Codes.BadOutOfRange),
        (-0.1, Codes.BadOutOfRange),
        (float("nan"), Codes.BadOutOfRange),
        (1, Codes.BadTypeMismatch),
        ("1", Codes.BadTypeMismatch),
        ([1.0], Codes.BadTypeMismatch),
    ],
)
async def test_a_written_value_is_checked_before_it_is_taken(plant, operator, value, code):
    plant.written.clear()
    variable = operator.get_node(plant.command[Role.OPERATOR].id)
    assert await code_of(variable.write_value(value)) == code
    assert plant.written == ([value] if code == Codes.Good else [])


async def test_a_write_that_is_refused_changes_nothing(plant, operator):
    variable = operator.get_node(plant.command[Role.OPERATOR].id)
    await variable.write_value(10.0)
    plant.refuse = CommandRejected("not now")
    assert await code_of(variable.write_value(20.0)) == Codes.BadInvalidState
    plant.refuse = None
    assert await variable.read_value() == 10.0


async def test_a_bad_status_or_a_part_of_a_value_cannot_be_written(plant, operator):
    node = plant.command[Role.OPERATOR].id
    bad = ua.DataValue(ua.Variant(1.0), ua.StatusCode(Codes.Bad))
    part = ua.WriteValue(node, ua.AttributeIds.Value, "0", ua.DataValue(ua.Variant(1.0)))
    wrong = ua.WriteValue(node, ua.AttributeIds.Value, None, bad)
    codes = await operator.uaclient.write(ua.WriteParameters([part, wrong]))
    assert [code.value for code in codes] == [Codes.BadWriteNotSupported] * 2


def _text():
    return ua.DataValue(ua.Variant(ua.LocalizedText("x")))


class _Ignore:
    def datachange_notification(self, node, value, data):
        pass


async def test_role_permissions_say_what_each_role_may_at_a_node(plant, observer, operator):
    async def stated(client, node, attribute=ua.AttributeIds.RolePermissions):
        held = await client.get_node(node).read_attribute(attribute)
        return {one.RoleId.Identifier: one.Permissions for one in held.Value.Value}

    bits, ids = ua.PermissionType, ua.ObjectIds
    for role, method in plant.method.items():
        of = await stated(observer, method)
        may = {one for one, id_ in ROLE_IDS.items() if of[id_.Identifier] & bits.Call}
        assert may == {one for one in Role if one >= role}
    of = await stated(observer, plant.folder)
    assert all(one & bits.Browse and not one & bits.Write for one in of.values())
    own = await stated(observer, plant.folder, ua.AttributeIds.UserRolePermissions)
    assert set(own) == {ids.WellKnownRole_Observer}
    own = await stated(operator, plant.folder, ua.AttributeIds.UserRolePermissions)
    assert set(own) == {ids.WellKnownRole_Observer, ids.WellKnownRole_Operator}


async def test_every_method_below_objects_is_implemented(plant, observer):
    waiting, seen, dead = [observer.nodes.objects], set(), []
    while waiting:
        node = waiting.pop()
        if node.nodeid in seen:
            continue
        seen.add(node.nodeid)
        for part in await node.get_children_descriptions():
            child = observer.get_node(part.NodeId)
            if part.NodeClass != ua.NodeClass.Method:
                waiting.append(child)
            elif await code_of(node.call_method(part.NodeId)) == Codes.BadNotImplemented:
                dead.append(part.BrowseName.Name)
    assert not dead
    assert len(seen) > 100
