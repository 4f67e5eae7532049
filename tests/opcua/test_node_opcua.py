"""node-opcua as a client at our results server, secured and on the demo's open endpoint."""

import pytest
import pytest_asyncio

from support import node_peer
from support.interoperation import (
    Asking,
    ClientInteroperation,
    Codes,
    double,
    every_sample,
    raised,
)
from support.scada_interoperation import ScadaInteroperation

pytestmark = [pytest.mark.node, pytest.mark.asyncio(loop_scope="module")]


@pytest.fixture(scope="module")
def program(request):
    return node_peer.program(request.config.cache.mkdir("node_peer"), "client.cjs")


class TestNodeOpcua(ClientInteroperation):
    """The list that every stack goes through."""


class TestNodeOpcuaAsScada(ScadaInteroperation):
    """Types, alarms and trends."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def anonymous(peer, tmp_path_factory):
    async with raised(tmp_path_factory.mktemp("demo"), none_on_loopback=True) as stage:
        anonymous = Asking(peer, "anonymous")
        await anonymous.ask("connect", url=stage.server.url)
        yield anonymous
        await anonymous.ask("disconnect")


async def test_on_the_demos_open_endpoint_anybody_may_look(anonymous):
    await anonymous.subscribe(every_sample("RLS.Residual"))
    (residuals,) = await anonymous.watch(0.5)
    assert len(residuals) >= 3
    predicted = await anonymous.call("RLS", "Predict", double(50.0), double(100.0), double(40.0))
    assert predicted["code"] == Codes.Good


async def test_on_the_demos_open_endpoint_only_a_user_may_touch(anonymous):
    assert await anonymous.write("Inverse.FlowDemand", double(50.0)) == Codes.BadUserAccessDenied
    assert (await anonymous.call("RLS", "Reset"))["code"] == Codes.BadUserAccessDenied
