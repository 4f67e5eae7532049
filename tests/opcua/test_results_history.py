"""The history of signals and results, read by a plain client from a real results server."""

import datetime as dt

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua

from support.results import results_settings
from support.served import patient
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples, Segments
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.runtime.past import PastKeeper
from valvemap.storage.history import HistoryFile

pytestmark = pytest.mark.asyncio(loop_scope="module")

S = 1_000_000_000
START, N = 1_800_000_000 * S, 500
STEP = S // 100


def samples():
    k = np.arange(N)
    U, dp = (37.0 * k) % 100.0, 1.0 + (61.0 * k) % 200.0
    Q = 0.14 * U * np.sqrt(dp)
    quality = np.where(k % 50 == 49, 1, 0)
    return Samples.of(START + STEP * k, U, dp + 5.0, np.full(N, 5.0), Q, quality=quality)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(tmp_path_factory):
    plan = ValvePlan("V1", QualityGate(), {"RLS": RecursiveLeastSquares()}, inverse="RLS")
    identification = Identification([plan], Alignment(AlignmentSettings(), optional=((),)))
    settings = results_settings(none_on_loopback=True)
    with HistoryFile(tmp_path_factory.mktemp("history") / "history.sqlite") as store:
        keeper = PastKeeper(store, ["V1"])
        described = identification.descriptions()
        async with ResultsServer(settings, described, identification, past=store) as server:
            for start in range(0, N, 50):
                some = samples()[start : start + 50]
                keeper.take(ByValve(some, Segments.one(50)))
                identification.take_samples(0, some)
                for results in identification.results.of([0]):
                    await server.publish(results)
                    keeper.note(results)
            await keeper.settle()
            async with patient(server.url) as made:
                yield made


def moment(k):
    return dt.datetime.fromtimestamp(START / S + k / 100, dt.UTC)


async def node_of(client, name):
    index = await client.get_namespace_index(NAMESPACE)
    return client.get_node(ua.NodeId(f"V1.{name}", index))


async def test_every_sample_of_a_signal_is_there(client):
    node = await node_of(client, "Signals.Q")
    found = await node.read_raw_history(moment(0), moment(N), 0)
    assert [value.Value.Value for value in found[:N]] == samples().Q.tolist()
    assert found[N].StatusCode.name == "BadBoundNotFound"
    doubtful = [not value.StatusCode.is_good() for value in found[:N]]
    assert sum(doubtful) == N / 50


async def test_what_was_not_measured_is_bad(client):
    node = await node_of(client, "Signals.T")
    found = await node.read_raw_history(moment(0), moment(N), 0)
    assert {value.StatusCode.name for value in found[:10]} == {"BadNoData"}


async def test_results_are_there_as_they_were_published(client):
    node = await node_of(client, "RLS.Residual")
    found = await node.read_raw_history(moment(0), moment(N), 0)
    found = [value for value in found if value.StatusCode.name != "BadBoundNotFound"]
    assert len(found) == N // 50
    newest = await node.read_data_value(raise_on_bad_status=False)
    assert found[-1].Value.Value == newest.Value.Value


async def test_a_trend_asks_for_averages(client):
    node = await node_of(client, "Signals.Q")
    aggregate = ua.NodeId(ua.ObjectIds.AggregateFunction_Average)
    config = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=True)
    details = ua.ReadProcessedDetails(moment(0), moment(N), 1_000.0, [aggregate], config)
    request = ua.HistoryReadRequest()
    request.Parameters = ua.HistoryReadParameters(
        details,
        ReleaseContinuationPoints=False,
        NodesToRead=[ua.HistoryReadValueId(node.nodeid, ContinuationPoint=None)],
    )
    data = await client.uaclient.protocol.send_request(request)
    (result,) = ua.ua_binary.struct_from_binary(ua.HistoryReadResponse, data).Results
    assert result.StatusCode.name == "Good"
    good = samples().quality == 0
    expected = [samples().Q[100 * k :][:100][good[100 * k :][:100]].mean() for k in range(5)]
    values = [value.Value.Value for value in result.HistoryData.DataValues]
    assert values == pytest.approx(expected)


@pytest.mark.parametrize("name", ["RLS.Status", "Inverse.RequiredUStatus"])
async def test_statuses_are_whole_numbers_and_good(client, name):
    node = await node_of(client, name)
    found = await node.read_raw_history(moment(0), moment(N), 0)
    whole = [value for value in found if value.StatusCode.name != "BadBoundNotFound"]
    assert whole
    assert {value.StatusCode.name for value in whole} == {"Good"}
    assert {value.Value.VariantType for value in whole} == {ua.VariantType.Int32}


@pytest.mark.parametrize("name", ["RLS.Adaptation", "RLS.ParameterVector", "Diagnostics.Aligned"])
async def test_what_is_not_kept_says_so(client, name):
    node = await node_of(client, name)
    assert ua.AccessLevel.HistoryRead not in await node.get_access_level()


async def test_the_server_says_that_there_is_a_history(client):
    said = ua.ObjectIds.HistoryServerCapabilities_AccessHistoryDataCapability
    assert await client.get_node(ua.NodeId(said)).read_value() is True
