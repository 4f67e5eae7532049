"""A client of another stack (node-opcua) looks at our servers."""

import asyncio
from contextlib import asynccontextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest
import pytest_asyncio
from support.node_client import install, run_plan
from support.plant import plant

from service.identification.model_structures import FiveTerms
from service.identification.recursive_least_squares import RecursiveLeastSquares
from service.opcua.hardened import Pki, Role, ServerSettings, UserStore, ensure_certificate
from service.opcua.hardened.certificates import trust
from service.opcua.results_server import NAMESPACE, ResultsServer
from service.streaming.alignment import Alignment, AlignmentSettings
from service.streaming.identification import Identification
from service.streaming.pipeline import ValvePlan
from service.streaming.quality_gate import QualityGate

pytestmark = [pytest.mark.node, pytest.mark.asyncio(loop_scope="module")]

PREFIX = f"nsu={NAMESPACE};s=Valvistor"


@pytest.fixture(scope="module")
def node_client(request):
    return install(request.config.cache.mkdir("node_client"))


def identification():
    plan = ValvePlan(
        name="Valvistor",
        gate=QualityGate(),
        estimators={"RLS": RecursiveLeastSquares(FiveTerms())},
        inverse="RLS",
    )
    return Identification([plan], Alignment(AlignmentSettings(), has_T=(True,)))


async def identify(live, server):
    """Take 20 samples in and show them, 20 times a second."""
    first = 0
    while True:
        live.take_samples(0, plant(20, seed=first + 1, first=first))
        live.refresh_maps()
        await server.publish([live.result(0)])
        first += 20
        await asyncio.sleep(0.05)


@asynccontextmanager
async def running(settings):
    live = identification()
    async with ResultsServer(settings, live.descriptions(), live) as server:
        task = asyncio.create_task(identify(live, server))
        try:
            yield server, live
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task


def settings_with(cache, users, **more):
    return ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/service/",
        application_uri="urn:test:service",
        application_name="service",
        namespace_uri=NAMESPACE,
        users=users,
        cache=cache,
        **more,
    )


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served(cache):
    users, password = UserStore.one_time("operator", Role.OPERATOR)
    async with running(settings_with(cache, users, none_on_loopback=True)) as (server, live):
        yield server, live, password


def double(value):
    return {"type": "Double", "value": value}


def call(owner, method, *inputs):
    owner = f"{PREFIX}.{owner}"
    return {"op": "call", "owner": owner, "method": f"{owner}.{method}", "inputs": inputs}


def prop(node, name):
    return {"op": "property", "node": f"{PREFIX}.{node}", "name": name}


def read(node):
    return {"op": "read", "node": f"{PREFIX}.{node}"}


def write(node, value):
    return {"op": "write", "node": f"{PREFIX}.{node}", "value": double(value)}


def subscribe(node, seconds):
    return {"op": "subscribe", "nodes": [f"{PREFIX}.{node}"], "seconds": seconds}


async def ask(node_client, server, steps, **who):
    """Let one node process take all steps: starting it costs most of the time."""
    outcome = await run_plan(node_client, {"url": server.url, "steps": list(steps.values()), **who})
    assert "error" not in outcome, outcome["error"]
    return dict(zip(steps, outcome["results"], strict=True))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def observed(served, node_client):
    path = ["Identification", "Valvistor"]
    steps = {
        "valve": {"op": "browse", "path": path, "namespace": NAMESPACE},
        "units": prop("RLS.PredictedFlow", "EngineeringUnits"),
        "range": prop("RLS.PredictedFlow", "EURange"),
        "names": prop("RLS.Status", "EnumStrings"),
        "axis": prop("Inverse.Map", "XAxisDefinition"),
        "parameters": subscribe("RLS.ParameterVector", 2.0),
        "map": read("Inverse.Map"),
        "invert": call("Inverse", "Invert", double(51.0), double(100.0), double(40.0)),
        "predict": call("RLS", "Predict", double(50.0), double(100.0), double(40.0)),
        "reset": call("RLS", "Reset"),
        "demand": write("Inverse.FlowDemand", 50.0),
    }
    return await ask(node_client, served[0], steps)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def operated(served, node_client):
    server, live, password = served
    steps = {
        "flow": write("Inverse.FlowDemand", 51.0),
        "pressure": write("Inverse.PressureDrop", 100.0),
        "too much": write("Inverse.FlowDemand", 1e6),
        "required": subscribe("Inverse.RequiredU", 0.5),
        "forget": call("RLS", "SetForgettingFactor", double(0.999)),
        "wrong": call("RLS", "SetForgettingFactor", {"type": "String", "value": "much"}),
        "freeze": call("RLS", "Freeze"),
        "resume": call("RLS", "Resume"),
    }
    found = await ask(node_client, server, steps, user="operator", password=password)
    return found, live.lane("Valvistor", "RLS").lam


async def test_it_finds_the_valve_where_the_contract_says(observed):
    assert observed["valve"]["node"].endswith("s=Valvistor")
    children = set(observed["valve"]["children"])
    assert children.issuperset({"RLS", "Inverse", "Diagnostics"})


async def test_it_reads_engineering_units_and_enumerations(observed):
    units, span = observed["units"]["value"], observed["range"]["value"]
    assert (units["unitId"], units["displayName"]["text"]) == (19506, "l/min")
    assert (span["low"], span["high"]) == (0, 200)
    assert observed["names"]["value"][0]["text"] == "OK"
    assert observed["axis"]["value"]["title"]["text"] == "Pressure drop"


async def test_it_sees_the_parameters_move_and_settle(observed):
    (vectors,) = observed["parameters"]["changes"]
    assert len({tuple(vector["value"]) for vector in vectors}) >= 10
    times = [vector["time"] for vector in vectors]
    assert times == sorted(set(times))
    assert vectors[-1]["status"] == "Good"
    a = np.array(vectors[-1]["value"])
    np.testing.assert_allclose(a[[0, 3, 4]], [3.0, 0.1, -0.02], atol=0.2)


async def test_it_predicts_and_inverts_and_the_two_agree(observed):
    U, lower, upper, status = observed["invert"]["outputs"]
    assert (observed["invert"]["status"], status) == ("Good", 0)
    assert lower <= U <= upper
    assert pytest.approx(50.0, abs=0.5) == U
    assert observed["predict"]["outputs"][0] == pytest.approx(51.0, abs=0.5)


async def test_it_reads_the_map_as_a_matrix(observed):
    table = observed["map"]
    assert table["dimensions"] == [21, 20]
    assert (len(table["value"]), table["status"]) == (420, "Good")


async def test_without_a_user_it_may_look_but_not_touch(observed):
    assert observed["reset"]["status"] == "BadUserAccessDenied"
    assert observed["demand"]["status"] == "BadUserAccessDenied"


async def test_as_operator_it_demands_a_flow_and_reads_the_voltage_for_it(operated):
    found, _ = operated
    statuses = [found[name]["status"] for name in ("flow", "pressure", "too much")]
    assert statuses == ["Good", "Good", "BadOutOfRange"]
    last = found["required"]["changes"][0][-1]
    assert (last["type"], last["status"]) == ("Double", "Good")
    assert last["value"] == pytest.approx(50.0, abs=0.5)


async def test_as_operator_it_commands_an_estimator(operated):
    found, lam = operated
    statuses = [found[name]["status"] for name in ("forget", "freeze", "resume")]
    assert statuses == ["Good"] * 3
    assert lam == 0.999
    assert found["wrong"]["status"] == "BadInvalidArgument"
    assert found["wrong"]["inputs"] == ["BadTypeMismatch"]


@pytest.mark.parametrize("policy", ["Basic256Sha256", "Aes256_Sha256_RsaPss"])
async def test_secured_it_is_let_in_once_it_is_trusted(cache, node_client, tmp_path, policy):
    users, password = UserStore.one_time("operator", Role.OPERATOR)
    pki, theirs = Pki(tmp_path / "server"), Pki(tmp_path / "client")
    own = ensure_certificate(theirs, "urn:test:node", ("localhost", "127.0.0.1"), "node")
    settings = replace(settings_with(cache, users), pki=pki)
    async with running(settings) as (server, _):
        trust(pki, own.certificate)
        security = {
            "policy": policy,
            "certificate": str(own.certificate),
            "key": str(own.key),
            "applicationUri": "urn:test:node",
            "pki": str(tmp_path / "node"),
        }
        steps = {
            "count": read("RLS.SampleCount"),
            "residuals": subscribe("RLS.Residual", 0.5),
            "demand": write("Inverse.FlowDemand", 51.0),
        }
        who = {"user": "operator", "password": password, "security": security}
        found = await ask(node_client, server, steps, **who)
    assert found["count"]["type"] == "UInt64"
    assert len(found["residuals"]["changes"][0]) >= 3
    assert found["demand"]["status"] == "Good"
