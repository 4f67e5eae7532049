"""Our own client on our own server: alarms as they change, past alarms, courses of the history."""

import asyncio

import pytest
import pytest_asyncio

from support.conditions import S, raised
from support.plant import START
from valvemap.errors import CommandRejected
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.storage.history import HistoryFile

pytestmark = pytest.mark.asyncio(loop_scope="module")

EVER = START - 10 * S, START + 10_000 * S


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant(tmp_path_factory):
    with HistoryFile(tmp_path_factory.mktemp("history") / "history.sqlite") as store:
        async with raised(store=store) as plant:
            yield plant


@pytest_asyncio.fixture(loop_scope="module")
async def client(plant):
    client = ResultsClient(SourceSettings(url=plant.server.url), NAMESPACE)
    await client.connect()
    yield client
    await client.close()


async def changes(client, most):
    found = []
    async with asyncio.timeout(20):
        while len(found) < most:
            found += client.conditions()
            await asyncio.sleep(0.05)
    return found


async def test_present_alarms_come_first_then_their_changes_and_all_are_in_the_history(
    plant, client
):
    await plant.set_lag(0.3)
    await client.listen(0.1)
    (came,) = await changes(client, 1)
    assert (came.source, came.name, came.active, came.acked) == (
        *("Valvistor", "LagFound"),
        *(True, False),
    )
    assert came.text.startswith("A signal lags by 0.3 s")
    plant.clock.advance(1.0)
    await plant.set_lag(0.0)
    (went,) = await changes(client, 1)
    assert (went.active, went.retain) == (False, True)
    await plant.past.settle()
    past = await client.past_conditions(EVER, 10)
    assert {went.event, came.event} <= {change.event for change in past}
    assert [change.t for change in past] == sorted((c.t for c in past), reverse=True)
    assert len(await client.past_conditions(EVER, 1)) == 1


async def test_values_can_be_followed_beside_events_and_given_up(plant, client):
    await client.listen(0.1)
    await client.follow(["Valvistor.RLS.Residual"], 0.1)
    await client.follow([], 0.1)
    await plant.set_lag(0.4)
    assert (await changes(client, 1))[-1].name == "LagFound"


async def test_a_variable_without_a_history_says_so(client):
    found = await client.courses(
        [("Valvistor.RLS.Adaptation", "Average"), ("Valvistor.Signals.Q", "Maximum")],
        (START, START + 10 * S),
        S,
    )
    assert found[0].code >> 31
    assert [len(course.times) for course in found] == [0, 10]
    assert found[1].times[0] == START


async def test_a_server_without_a_history_is_told_apart(plant):
    async with raised() as other:
        client = ResultsClient(SourceSettings(url=other.server.url), NAMESPACE)
        await client.connect()
        with pytest.raises(CommandRejected, match="no past alarms"):
            await client.past_conditions(EVER, 1)
        found = await client.courses([("Valvistor.Signals.Q", "Average")], (START, START + S), S)
        assert found[0].code >> 31
        await client.close()
