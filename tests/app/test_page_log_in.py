"""A user who guesses on the page is locked at the service by address; the operator is let in."""

import asyncio
from contextlib import asynccontextmanager

import pytest

from guarded_opcua import HardenedServer, Role, ServerSettings, UserStore
from support.page_attacks import Visitor
from support.users import CHEAP
from valvemap.app.dashboard import run_dashboard
from valvemap.app.identities import PAGE_URI
from valvemap.app.page_access import Watched
from valvemap.opcua_client.source_settings import Security
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE
from valvemap.page.settings import PageSettings

pytestmark = pytest.mark.waits


@asynccontextmanager
async def page_of(users, folder, gateways):
    """The URL of the page of a service with these users."""
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/service/",
        application_uri=SERVICE_NAMESPACE,
        application_name="service",
        namespace_uri=SERVICE_NAMESPACE,
        users=users,
        none_on_loopback=True,
        gateways=gateways,
    )
    async with await HardenedServer.create(settings) as server:
        stop, said = asyncio.Event(), asyncio.get_running_loop().create_future()
        watched = Watched(server.url, Security.NONE, folder)
        page = asyncio.create_task(
            run_dashboard(watched, PageSettings(port=0), stop, said.set_result)
        )
        try:
            yield await said
        finally:
            stop.set()
            await page


async def test_guesses_from_many_addresses_lock_no_operator_out(tmp_path):
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, "correct horse")
    async with page_of(users, tmp_path, frozenset({PAGE_URI})) as url:
        for number in range(2, 5):
            guesser = Visitor(url, f"127.0.0.{number}")
            for _ in range(5):
                assert await guesser.log_in("operator", "wrong") == 403
            assert await guesser.log_in("operator", "correct horse") == 403
        began = asyncio.get_running_loop().time()
        assert await Visitor(url, "127.0.0.9").log_in("operator", "correct horse") == 200
        assert asyncio.get_running_loop().time() - began <= 5.0


async def test_a_service_that_trusts_no_page_counts_the_page_s_own_address(tmp_path):
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, "correct horse")
    async with page_of(users, tmp_path, frozenset()) as url:
        for number in (2, 3):
            for _ in range(3):
                await Visitor(url, f"127.0.0.{number}").log_in("operator", "wrong")
        assert await Visitor(url, "127.0.0.9").log_in("operator", "correct horse") == 403
