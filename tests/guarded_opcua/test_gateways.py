"""Users who log in by way of a gateway are locked by the address that they came from."""

import pytest
from asyncua import ua
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256, encrypt_asymmetric
from asyncua.ua import ua_binary

from guarded_opcua import HardenedServer, Role, ServerSettings, UserStore
from support.raw_peer import RawPeer
from support.users import CHEAP

PASSWORD = "correct horse"
GATEWAY, OTHER = "urn:test:page", "urn:test:client"


@pytest.fixture
async def url():
    users = UserStore(cost=CHEAP)
    users.add("olga", Role.OPERATOR, PASSWORD)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/gate/",
        application_uri="urn:test:server",
        application_name="server",
        namespace_uri="urn:test:server",
        users=users,
        none_on_loopback=True,
        gateways=frozenset({GATEWAY}),
    )
    async with await HardenedServer.create(settings) as server:
        yield server.url


async def lets_in(url, password, entry, application_uri=GATEWAY):
    """Whether the server lets a user in whom a client announces so."""
    peer = await RawPeer.connect(url)
    try:
        await peer.open()
        made = await peer.create_session(application_uri)
        key = uacrypto.x509_from_der(made.ServerCertificate).public_key()
        secret = ua_binary.Primitives.Bytes.pack(password.encode() + made.ServerNonce)
        token = ua.UserNameIdentityToken("username", "olga", b"", None)
        token.Password, token.EncryptionAlgorithm = encrypt_asymmetric(
            key, secret, SecurityPolicyBasic256Sha256.URI
        )
        try:
            await peer.activate(token, entry)
        except ua.uaerrors.BadUserAccessDenied:
            return False
        return True
    finally:
        peer.close()


async def lock(url, entry, application_uri=GATEWAY):
    for _ in range(5):
        assert not await lets_in(url, "wrong", entry, application_uri)
    assert not await lets_in(url, PASSWORD, entry, application_uri)


async def test_wrong_passwords_lock_the_address_behind_the_gateway_and_no_other(url):
    await lock(url, "10.0.0.2")
    assert await lets_in(url, PASSWORD, "10.0.0.9")
    assert await lets_in(url, PASSWORD, "2001:db8::/64")
    assert await lets_in(url, PASSWORD, "", OTHER)


async def test_a_client_that_is_no_gateway_names_no_addresses(url):
    await lock(url, "10.0.0.2", OTHER)
    assert not await lets_in(url, PASSWORD, "10.0.0.9", OTHER)
    assert await lets_in(url, PASSWORD, "10.0.0.2")


@pytest.mark.parametrize("entry", ["", "somewhere", "10.0.0.999", "\x00" * 4_000])
async def test_what_is_no_address_counts_as_the_gateway_s_own(url, entry):
    await lock(url, entry)
    assert not await lets_in(url, PASSWORD, "")
    assert await lets_in(url, PASSWORD, "10.0.0.9")
