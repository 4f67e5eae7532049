"""Which servers our client believes: every certificate case on the wire."""

import asyncio
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
    ensure_certificate,
)
from support import certificate_cases as cases
from support.impostor import Impostor
from support.users import CHEAP
from valvemap.errors import SourceLost, SourceRejected
from valvemap.opcua_client.connection import open_connection
from valvemap.opcua_client.source_settings import Security, SourceSettings

pytestmark = pytest.mark.asyncio(loop_scope="module")

GONE_WITHIN_S = 10.0


def named(case):
    return case.__name__


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def impostor():
    async with Impostor().listening() as impostor:
        yield impostor


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    pki = Pki(tmp_path_factory.mktemp("client"))
    own = ensure_certificate(pki, "urn:test:client", ("localhost",), "client")
    return SourceSettings(
        "opc.tcp://127.0.0.1:4840/",
        security=Security.BASIC256_SHA256,
        pki=pki,
        own=own,
        timeout_s=2.0,
    )


async def meeting(impostor, settings, identity, chain=()):
    """Let our client meet a server; return why it refused, '' if it went on."""
    impostor.shown = identity.der + b"".join(link.der for link in chain)
    believed = impostor.believed
    reason = ""
    try:
        await open_connection(replace(settings, url=impostor.url))
    except SourceRejected as rejected:
        reason = str(rejected)
    except SourceLost:
        pass  # it hangs up on who believes it
    assert (impostor.believed > believed) == (reason == "")
    return reason


class TestServersOfOurClient:
    @pytest.mark.parametrize("case", cases.REFUSED, ids=named)
    async def test_refused_is(self, impostor, ours, case):
        identity, chain = cases.shown(case, ours.pki)
        assert await meeting(impostor, ours, identity, chain)

    @pytest.mark.parametrize("case", cases.ACCEPTED, ids=named)
    async def test_accepted_is(self, impostor, ours, case):
        identity, chain = cases.shown(case, ours.pki)
        settings = replace(ours, check_host_name="constraints" not in case.__name__)
        assert await meeting(impostor, settings, identity, chain) == ""

    @pytest.mark.parametrize(
        "hosts", [(), ("plant.example",), ("127.0.0.2",), ("localhost",)], ids=str
    )
    async def test_a_certificate_of_another_host_is_refused_and_the_setting_named(
        self, impostor, ours, hosts
    ):
        identity = cases.shown(lambda pki: cases.trusted_itself(pki, hosts=hosts), ours.pki)[0]
        reason = await meeting(impostor, ours, identity)
        assert "does not name the host 127.0.0.1" in reason
        assert "source.check_host_name = false" in reason
        assert await meeting(impostor, replace(ours, check_host_name=False), identity) == ""

    async def test_a_missing_revocation_list_names_its_setting(self, impostor, ours):
        identity, _ = cases.shown(cases.one_without_a_revocation_list, ours.pki)
        assert "security.require_crl = false" in await meeting(impostor, ours, identity)
        assert await meeting(impostor, replace(ours, require_crl=False), identity) == ""


@pytest.mark.waits
async def test_our_client_hangs_up_on_a_server_that_is_trusted_no_more(tmp_path):
    ours, its = Pki(tmp_path / "client"), Pki(tmp_path / "server")
    for pki in (ours, its):
        pki.make_folders()
    hosts = ("localhost", "127.0.0.1")
    own = ensure_certificate(ours, "urn:test:client", hosts, "client")
    theirs = ensure_certificate(its, "urn:test:server", hosts, "server")
    (its.trusted / "client.der").write_bytes(own.certificate.read_bytes())
    trusted = ours.trusted / "server.der"
    trusted.write_bytes(theirs.certificate.read_bytes())
    users, password = UserStore.one_time("bert", Role.OBSERVER, CHEAP)
    server = await HardenedServer.create(
        ServerSettings(
            url="opc.tcp://127.0.0.1:0/trust/",
            application_uri="urn:test:server",
            application_name="server",
            namespace_uri="urn:test",
            pki=its,
            users=users,
        )
    )
    async with server:
        settings = SourceSettings(
            server.url,
            security=Security.BASIC256_SHA256,
            pki=ours,
            own=own,
            user="bert",
            password=password,
        )
        connection = await open_connection(settings)
        trusted.unlink()
        state = ua.NodeId(ua.ObjectIds.Server_ServerStatus_State)
        read = ua.ReadParameters(NodesToRead=[ua.ReadValueId(state, ua.AttributeIds.Value)])

        async def read_until_lost():
            while True:
                with connection.errors("reading"):
                    await connection.session.read(read)
                await asyncio.sleep(0.05)

        with pytest.raises(SourceLost):
            await asyncio.wait_for(read_until_lost(), GONE_WITHIN_S)
        await connection.close()
        with pytest.raises(SourceRejected, match="is not trusted"):
            await open_connection(settings)
