"""Every certificate case on the wire: peers of our server, and its users."""

import asyncio
import logging

import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import (
    HardenedServer,
    Limits,
    Pki,
    Role,
    ServerSettings,
    UserStore,
)
from guarded_opcua.logs import AUDIT
from support import certificate_cases as cases
from support.certificates import EMAIL, name, root, self_signed
from support.secure_peer import SecurePeer

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
GONE_WITHIN_S = 10.0


def named(case):
    return case.__name__


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server(tmp_path_factory):
    pki = Pki(tmp_path_factory.mktemp("pki"))
    pki.make_folders()
    users = tmp_path_factory.mktemp("users") / "users.json"
    UserStore().save(users)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/certificates/",
        application_uri="urn:test:certificates",
        application_name="certificates",
        namespace_uri="urn:certificates",
        pki=pki,
        users=UserStore.load(users),
        limits=Limits(connections_per_second=1_000),
    )
    server = await HardenedServer.create(settings)
    server.pki, server.users_file = pki, users
    async with server:
        yield server


@pytest.fixture
def pki(server):
    for folder in (server.pki.trusted, server.pki.issuers, server.pki.rejected):
        for file in folder.iterdir():
            file.unlink()
    return server.pki


async def code_of(action):
    try:
        await action
    except ua.UaStatusCodeError as error:
        return error.code
    return Codes.Good


async def opening(server, identity, chain=()):
    """Status code with which a channel is refused; Good if it opens."""
    try:
        peer = await SecurePeer.opened(server, identity, chain)
    except ua.UaStatusCodeError as error:
        return error.code
    peer.close()
    return Codes.Good


class TestPeersOfOurServer:
    @pytest.mark.parametrize(("case", "code"), cases.REFUSED.items(), ids=map(named, cases.REFUSED))
    async def test_refused_is(self, server, pki, case, code):
        identity, chain = cases.shown(case, pki)
        assert await opening(server, identity, chain) == code

    @pytest.mark.parametrize("case", cases.ACCEPTED, ids=named)
    async def test_accepted_is(self, server, pki, case):
        identity, chain = cases.shown(case, pki)
        assert await opening(server, identity, chain) == Codes.Good

    async def test_who_brings_a_chain_logs_in_and_renews(self, server, pki):
        identity, chain = cases.shown(cases.one_that_brings_its_intermediate_along, pki)
        user = add_user(server, self_signed("anna", number=4))
        peer = await SecurePeer.opened(server, identity, chain)
        whole = identity.der + chain[0].der
        await peer.create(whole)
        await peer.activate_as(user)
        await peer.renew()
        assert await peer.read_state() == 0
        peer.close()


def add_user(server, user, login="anna", role=Role.ENGINEER):
    """Let a user in by certificate, as ``valvemap trust --user`` does in its own process."""
    users = UserStore.load(server.users_file)
    users.add_certificate(login, role, user.der)
    users.save(server.users_file)
    server.settings.users.refresh()
    return user


async def logged_in(server, pki, user, chain=()):
    peer = await SecurePeer.opened(server, cases.trusted_itself(pki))
    code = await code_of(peer.log_in_as(user, chain))
    return peer, code


async def log_in_code(server, pki, user, chain=()):
    peer, code = await logged_in(server, pki, user, chain)
    peer.close()
    return code


class TestUsers:
    async def test_a_user_logs_in_with_a_certificate(self, server, pki):
        user = add_user(server, self_signed("anna", number=4))
        peer, code = await logged_in(server, pki, user)
        assert code == Codes.Good
        assert await peer.read_state() == 0
        (session,) = [s for s in server._sessions if s.line is not None and s.host == "127.0.0.1"]
        assert session.role is Role.ENGINEER
        peer.close()

    @pytest.mark.parametrize(
        "wishes",
        [
            {"days": (-30, -1)},
            {"days": (2, 30)},
            {"uses": ("key_encipherment",)},
            {"extended": [EMAIL]},
            {"weak": "sha1"},
        ],
        ids=str,
    )
    async def test_a_certificate_that_is_out_of_time_or_use_is_refused(self, server, pki, wishes):
        user = add_user(server, self_signed("anna", number=4, **wishes))
        assert await log_in_code(server, pki, user) == Codes.BadIdentityTokenRejected

    async def test_a_stranger_is_refused_though_its_name_and_application_are_known(
        self, server, pki
    ):
        add_user(server, self_signed("anna", number=4))
        for stranger in (self_signed("anna", number=3), cases.trusted_itself(pki, number=3)):
            assert await log_in_code(server, pki, stranger) == Codes.BadUserAccessDenied

    async def test_an_authority_certifies_users_under_their_names(self, server, pki):
        authority = root()
        add_user(server, authority)
        authority.keep(pki.issuers)
        user, other = authority.issue("anna", number=4), authority.issue("bert", number=4)
        assert await log_in_code(server, pki, user) == Codes.BadIdentityTokenRejected  # no CRL
        authority.keep_crl(pki.issuers)
        assert await log_in_code(server, pki, user) == Codes.Good
        assert await log_in_code(server, pki, other) == Codes.BadUserAccessDenied
        authority.keep_crl(pki.issuers, user)
        assert await log_in_code(server, pki, user) == Codes.BadIdentityTokenRejected

    async def test_a_user_needs_the_key(self, server, pki):
        user = add_user(server, self_signed("anna", number=4))
        thief = type(user)(user.certificate, self_signed(number=3).key)
        assert await log_in_code(server, pki, thief) == Codes.BadUserSignatureInvalid


async def gone_within(peer, seconds):
    loop = asyncio.get_running_loop()
    began = loop.time()
    assert await peer.is_closed(seconds)
    peer.close()
    return loop.time() - began


@pytest.mark.waits
class TestTrustTakenAway:
    """What must be gone within 10 s, without the peer doing anything."""

    async def connected(self, server, pki):
        user = add_user(server, self_signed("anna", number=4))
        authority = root()
        authority.keep(pki.trusted)
        authority.keep_crl(pki.issuers)
        identity = authority.issue()
        peer = await SecurePeer.opened(server, identity)
        await peer.log_in_as(user)
        assert await peer.read_state() == 0
        return peer, authority, identity

    @pytest.mark.parametrize("how", ["removed", "revoked", "revocation list removed"])
    async def test_the_channel_is_closed_and_it_is_audited(self, server, pki, how, caplog):
        peer, authority, identity = await self.connected(server, pki)
        match how:
            case "removed":
                (pki.trusted / f"{authority.certificate.serial_number}.der").unlink()
            case "revoked":
                authority.keep_crl(pki.issuers, identity)
            case _:
                next(pki.issuers.glob("*.crl")).unlink()
        with caplog.at_level(logging.INFO, AUDIT):
            assert await gone_within(peer, GONE_WITHIN_S) < GONE_WITHIN_S
        assert "CN=peer" in caplog.text
        assert "session closed of anna (engineer)" in caplog.text
        assert server._sessions.get(peer.token) is None
        assert await opening(server, identity) != Codes.Good

    async def test_others_stay(self, server, pki):
        peer, authority, _ = await self.connected(server, pki)
        other = await SecurePeer.opened(server, cases.trusted_itself(pki, number=3))
        (pki.trusted / f"{authority.certificate.serial_number}.der").unlink()
        await gone_within(peer, GONE_WITHIN_S)
        await other.renew()
        other.close()

    async def test_a_channel_is_not_renewed(self, server, pki):
        peer, authority, _ = await self.connected(server, pki)
        (pki.trusted / f"{authority.certificate.serial_number}.der").unlink()
        assert await code_of(peer.renew()) == Codes.BadCertificateUntrusted
        peer.close()

    @pytest.mark.parametrize("how", ["removed", "another role", "revoked"])
    async def test_a_users_session_is_closed(self, server, pki, how):
        authority = root()
        authority.keep(pki.issuers)
        authority.keep_crl(pki.issuers)
        user = add_user(server, authority.issue("anna", number=4))
        peer, code = await logged_in(server, pki, user)
        assert code == Codes.Good
        match how:
            case "removed":
                UserStore().save(server.users_file)
            case "another role":
                users = UserStore.load(server.users_file)
                users.add_certificate("anna", Role.OBSERVER, user.der)
                users.save(server.users_file)
            case _:
                authority.keep_crl(pki.issuers, user)
        async with asyncio.timeout(GONE_WITHIN_S):
            while (code := await code_of(peer.read_state())) == Codes.Good:  # noqa: ASYNC110 - a poll
                await asyncio.sleep(0.05)
        assert code == Codes.BadSessionIdInvalid
        peer.close()


async def test_a_line_break_in_a_subject_forges_no_line_in_the_console_log(
    server, pki, capfd, caplog
):
    caplog.set_level(logging.WARNING)  # commands make it quieter
    forged = "2026-11-22 [info] session activated by anna"
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(message)s"))
    logging.getLogger().addHandler(handler)
    try:
        peer = self_signed(name(f"peer\n{forged}\r\x1b[2K\u2028"))
        assert await opening(server, peer) == Codes.BadCertificateUntrusted
    finally:
        logging.getLogger().removeHandler(handler)
    lines = capfd.readouterr().err.splitlines()
    found = [line for line in lines if forged in line]  # other handlers may show it, too
    assert found
    assert not any(line.startswith("2026") for line in found)
    assert all(line.isprintable() for line in found)
