"""The page's client: browse, read, follow, call, write, and typed errors."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest
import pytest_asyncio

from guarded_opcua import Limits, Role, UserStore
from support.results import ESTIMATOR, INVERSE, results_of, results_settings
from support.users import CHEAP
from valvemap.errors import CommandRejected, SourceLost, SourceRejected
from valvemap.model.inversion import Inversion
from valvemap.opcua_client.result_readings import Engineering
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.results import EstimatorDescription, ValveDescription
from valvemap.vocabulary.statuses import Status

pytestmark = pytest.mark.asyncio(loop_scope="module")

VALVE = ValveDescription(
    "V1",
    (EstimatorDescription("RLS", "", ("a1", "a2"), has_forgetting_factor=True),),
    map_Q=(0.0, 100.0),
    map_dp=(0.0, 50.0, 200.0),
    counters=("late",),
)


RIGHTS = (
    *("V1.Inverse.FlowDemand", "V1.RLS.Reset", "V1.Inverse.Invert", "V1.RLS.Residual"),
    "V1.RLS.Nonsense",
)


class Operator:
    def do(self, command):
        return getattr(self, command.action)(*command.arguments)

    def predict(self, _valve, _estimator, U, dp, _T):
        return U * dp, 0.5, Status.EXTRAPOLATING

    def invert(self, _valve, Q, _dp, _T):
        return Inversion(*(np.array([x]) for x in (Q, Q - 1, Q + 1)), np.array([0], np.uint8))

    def alarms(self, _valve):
        return ()

    def __getattr__(self, name):  # the other commands: nothing happens
        return lambda *_: None

    def freeze(self, _valve, _estimator):
        raise CommandRejected("not now")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    settings = results_settings(users=users, none_on_loopback=True)
    async with ResultsServer(settings, (VALVE,), Operator()) as server:
        yield server, password


@pytest_asyncio.fixture(loop_scope="module")
async def client(served):
    client = ResultsClient(SourceSettings(url=served[0].url), NAMESPACE)
    await client.connect()
    yield client
    await client.close()


async def test_what_is_below_a_node_is_found_by_its_identifier(client):
    found = {child.id: child for child in await client.browse("Identification")}
    assert sorted(found) == ["Identification.NodeVersion", "Service", "V1"]
    assert (found["V1"].is_variable, found["V1"].is_method) == (False, False)
    below = {child.id: child for child in await client.browse("V1.RLS")}
    assert below["V1.RLS.Residual"].is_variable
    assert below["V1.RLS.Predict"].is_method


async def test_scalars_arrays_and_texts_are_read_together(client):
    ids = ["V1.FrameNames", "V1.Inverse.MapDp", "V1.Diagnostics.Late", "V1.RLS.Residual"]
    names, axis, count, residual = await client.read(ids)
    assert names.value[0] == "Sequence"
    assert axis.value == [0.0, 50.0, 200.0]
    assert count.value == 0
    assert count.t > 1_700_000_000_000_000_000
    assert (residual.value, residual.code) == (None, 0x80320000)


async def test_more_is_read_than_one_request_may_hold(client):
    readings = await client.read(["V1.Inverse.MapDp"] * 2_500)
    assert {tuple(reading.value) for reading in readings} == {(0.0, 50.0, 200.0)}


async def test_what_is_not_there_is_a_code(client):
    (reading,) = await client.read(["V1.RLS.Nonsense"])
    assert (reading.value, reading.code) == (None, 0x80340000)


async def test_many_points_are_asked_for_in_one_go(client):
    points = [(0.5 * U, 2.0, math.nan) for U in range(120)]
    answers = await client.call("V1.RLS", "Predict", points)
    assert answers == [(1.0 * U, 0.5, 6) for U in range(120)]


async def test_an_observer_asks_but_does_not_command(client):
    ((U, lower, upper, status),) = await client.call("V1.Inverse", "Invert", [(60, 100, 40)])
    assert (U, lower, upper, status) == (60.0, 59.0, 61.0, 0)
    with pytest.raises(CommandRejected, match="BadUserAccessDenied"):
        await client.write("V1.Inverse.FlowDemand", 50.0)
    with pytest.raises(CommandRejected, match="BadUserAccessDenied"):
        await client.call("V1.RLS", "Reset", [()])
    assert await client.permitted(RIGHTS) == [False, False, True, False, False]


async def test_an_operator_writes_and_hears_what_is_refused(served):
    settings = SourceSettings(url=served[0].url, user="operator", password=served[1])
    operator = ResultsClient(settings, NAMESPACE)
    await operator.connect()
    await operator.write("V1.Inverse.FlowDemand", 50.0)
    assert await operator.permitted(RIGHTS) == [True, True, True, False, False]
    (demand,) = await operator.read(["V1.Inverse.FlowDemand"])
    assert demand.value == 50.0
    with pytest.raises(CommandRejected, match="BadOutOfRange"):
        await operator.write("V1.Inverse.FlowDemand", 5_000.0)
    with pytest.raises(CommandRejected, match="BadInvalidState"):
        await operator.call("V1.RLS", "Freeze", [()])
    await operator.close()
    wrong = ResultsClient(replace(settings, password="wrong"), NAMESPACE)
    with pytest.raises(SourceRejected, match="password"):
        await wrong.connect()


async def changes(client, wanted):
    """Take changes until one is what is wanted; return all."""
    found = []
    async with asyncio.timeout(20):
        while not any(wanted(*change) for change in found):
            found += client.changes()
            await asyncio.sleep(0.01)
    return found


async def until_subscriptions(client, count):
    """Wait until the server says that it has so many subscriptions."""
    async with asyncio.timeout(20):
        while (await client.read([2285]))[0].value != count:  # noqa: ASYNC110 - it is the server's
            await asyncio.sleep(0.05)


async def test_what_is_followed_comes_by_itself_result_by_result(served, client):
    await client.follow(["V1.Frame", "V1.Diagnostics.Late", "V1.RLS.Nonsense"], 0.1)
    await changes(client, lambda id_, _: id_ == "V1.Diagnostics.Late")
    for count in range(1, 6):
        await served[0].publish(results_of(0, {"RLS": ESTIMATOR}, INVERSE, late=count))
        await asyncio.sleep(0.06)  # the server's sampling
    found = await changes(client, lambda id_, r: id_.endswith("Late") and r.value == 5)
    sequences = [r.value[0] for id_, r in found if id_ == "V1.Frame" and r.value]
    assert sequences[-5:] == [sequences[-5] + k for k in range(5)]
    await until_subscriptions(client, 1)


@pytest.mark.waits
async def test_whoever_follows_less_is_sent_less_and_nothing_is_left_behind(served, client):
    await client.follow(["V1.Frame", "V1.Diagnostics.Late"], 0.1)
    await changes(client, lambda id_, _: id_ == "V1.Diagnostics.Late")
    await client.follow(["V1.Diagnostics.Late"], 0.1)
    await served[0].publish(results_of(0, {"RLS": ESTIMATOR}, INVERSE, late=9))
    found = await changes(client, lambda _, r: r.value == 9)
    assert {id_ for id_, _ in found} == {"V1.Diagnostics.Late"}
    for _ in range(2):
        await client.follow([], 0.1)
        assert client.changes() == []
    await until_subscriptions(client, 0)
    await client.follow(["V1.Diagnostics.Late"], 0.1)
    await changes(client, lambda _, r: r.value == 9)


async def test_a_server_without_room_refuses_and_is_read_as_before():
    limits = Limits(subscriptions=0)
    settings = results_settings(none_on_loopback=True, limits=limits)
    async with ResultsServer(settings, (VALVE,), Operator()) as server:
        client = ResultsClient(SourceSettings(url=server.url), NAMESPACE)
        await client.connect()
        with pytest.raises(SourceRejected, match="Subscriptions"):
            await client.follow(["V1.Frame"], 0.1)
        assert client.changes() == []
        assert (await client.read(["V1.Diagnostics.Late"]))[0].value == 0
        await client.close()


async def test_a_server_that_goes_while_it_is_followed_is_a_loss():
    settings = results_settings(none_on_loopback=True)
    async with ResultsServer(settings, (VALVE,), Operator()) as server:
        client = ResultsClient(SourceSettings(url=server.url), NAMESPACE)
        await client.connect()
        await client.follow(["V1.Diagnostics.Late"], 0.1)
        await changes(client, lambda *_: True)
    with pytest.raises(SourceLost):
        await changes(client, lambda *_: False)
    await client.close()
    with pytest.raises(SourceLost, match="not connected"):
        client.changes()


async def test_a_server_that_is_not_there_is_worth_another_try(client, unused_tcp_port):
    url = f"opc.tcp://127.0.0.1:{unused_tcp_port}/nobody/"
    with pytest.raises(SourceLost):
        await ResultsClient(SourceSettings(url=url), NAMESPACE).connect()
    other = ResultsClient(SourceSettings(url=client.url), "urn:other")
    with pytest.raises(SourceLost, match="urn:other"):
        await other.connect()
    with pytest.raises(SourceLost, match="not connected"):
        await other.read(["V1.Frame"])


async def test_types_are_those_of_scalars_alone(client):
    ids = ["V1.RLS.Residual", "V1.RLS.Status", "V1.Diagnostics.Late", "V1.FrameNames", "V1.Nowhere"]
    assert await client.scalar_types(ids) == ["Double", "Int32", "UInt64", None, None]


async def test_units_ranges_and_descriptions_are_those_of_the_nodes(client):
    ids = ["V1.RLS.Residual", "V1.RLS.Status", "V1.Nowhere"]
    residual, status, nowhere = await client.engineering(ids)
    assert residual.unit == "l/min"
    assert residual.range is not None
    assert residual.range[0] == -residual.range[1]
    assert all(one.description for one in (residual, status))
    assert (status.unit, status.range) == ("", None)
    assert nowhere == Engineering()


async def test_several_nodes_are_browsed_together(client):
    together = await client.browse_each(["Identification", "V1.RLS", "V1.Nowhere"])
    assert together[:2] == [await client.browse("Identification"), await client.browse("V1.RLS")]
    assert together[2] == []


async def test_what_is_watched_comes_when_it_changes_and_an_equal_value_does_not(served, client):
    await client.watch(["V1.RLS.NoiseStd", "V1.Diagnostics.Late"], 0.05)
    await served[0].publish(results_of(0, {"RLS": ESTIMATOR}, INVERSE, late=21))
    await changes(client, lambda _, r: r.value == 21)
    later = replace(ESTIMATOR, t=ESTIMATOR.t + 1_000)
    await served[0].publish(results_of(0, {"RLS": later}, INVERSE, late=22))
    found = await changes(client, lambda _, r: r.value == 22)
    assert "V1.RLS.NoiseStd" not in {id_ for id_, _ in found}
    assert client.lost == 0
