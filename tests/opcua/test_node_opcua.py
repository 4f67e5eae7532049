"""node-opcua as a client at our results server, secured and on the demo's open endpoint."""

import asyncio

import numpy as np
import pytest
import pytest_asyncio
from support import node_peer
from support.interoperation import (
    PERIOD_S,
    Asking,
    ClientInteroperation,
    Codes,
    double,
    every_sample,
    raised,
)

pytestmark = [pytest.mark.node, pytest.mark.asyncio(loop_scope="module")]


@pytest.fixture(scope="module")
def program(request):
    return node_peer.program(request.config.cache.mkdir("node_peer"), "client.cjs")


class TestNodeOpcua(ClientInteroperation):
    """The list that every stack goes through."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def anonymous(peer, tmp_path_factory):
    async with raised(tmp_path_factory.mktemp("demo"), none_on_loopback=True) as stage:
        anonymous = Asking(peer, "anonymous")
        await anonymous.ask("connect", url=stage.server.url)
        yield anonymous
        await anonymous.ask("disconnect")


async def listed(operator, name, **wanted):
    """Wait until its alarm list shows an alarm so."""
    async with asyncio.timeout(30.0):
        while True:
            shown = {alarm["name"]: alarm for alarm in await operator.ask("alarms")}
            found = shown.get(name)
            if found is not None and wanted.items() <= found.items():
                return found
            await asyncio.sleep(0.05)


async def test_its_alarm_list_shows_acknowledges_comments_and_confirms(operator, stage):
    alarms = stage.live._fleets[0].alarms
    alarms.note_lags(np.array([0]), np.array([0.3]))
    await asyncio.sleep(2 * PERIOD_S)
    await operator.ask("watchAlarms")  # what stood before it came shows by a refresh
    state = {"active": True, "acked": False, "confirmed": True, "retain": True}
    found = await listed(operator, "LagFound", **state)
    assert found["source"] == "Valvistor"
    assert "lags by 0.3 s (limit 0.1 s)" in found["text"]
    for method, comment, after in (
        ("AddComment", "the filter's", {}),
        ("Acknowledge", "seen", {"acked": True, "confirmed": False}),
        ("Confirm", "done", {"confirmed": True}),
    ):
        done = await operator.ask("act", name="LagFound", method=method, comment=comment)
        assert done["code"] == Codes.Good
        state |= after
        await listed(operator, "LagFound", **state, comment=comment)
    again = await operator.ask("act", name="LagFound", method="Confirm", comment="")
    assert again["code"] == Codes.BadConditionBranchAlreadyConfirmed
    alarms.note_lags(np.array([0]), np.array([0.0]))
    await listed(operator, "LagFound", active=False, retain=False)


async def test_on_the_demos_open_endpoint_anybody_may_look(anonymous):
    await anonymous.subscribe(every_sample("RLS.Residual"))
    (residuals,) = await anonymous.watch(0.5)
    assert len(residuals) >= 3
    predicted = await anonymous.call("RLS", "Predict", double(50.0), double(100.0), double(40.0))
    assert predicted["code"] == Codes.Good


async def test_on_the_demos_open_endpoint_only_a_user_may_touch(anonymous):
    assert await anonymous.write("Inverse.FlowDemand", double(50.0)) == Codes.BadUserAccessDenied
    assert (await anonymous.call("RLS", "Reset"))["code"] == Codes.BadUserAccessDenied
