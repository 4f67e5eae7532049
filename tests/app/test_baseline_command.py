"""`valvemap baseline` at a running service: an operator acts, everybody may compare."""

from contextlib import asynccontextmanager

import pytest

from guarded_opcua import Role, UserStore
from support.plant import as_changes, plant
from support.results import results_settings
from support.users import CHEAP
from valvemap.app.baseline import Action, act
from valvemap.app.page_access import Watched, settings_of
from valvemap.cli import run
from valvemap.errors import CommandRejected
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import Security
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.statuses import Status

VALVE = "V7"


@pytest.fixture
async def served(tmp_path):
    plan = ValvePlan(VALVE, QualityGate(), {"RLS": RecursiveLeastSquares()}, "RLS")
    identification = Identification([plan], Alignment(AlignmentSettings(), optional=(("T",),)))
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    settings = results_settings(users=users, none_on_loopback=True)
    described = identification.descriptions()
    async with ResultsServer(settings, described, identification) as server:

        def who(user=None):
            word = None if user is None else password
            return Watched(server.url, Security.NONE, tmp_path, user, word)

        yield identification, server, who


@asynccontextmanager
async def watching(service):
    client = ResultsClient(settings_of(service), SERVICE_NAMESPACE)
    await client.connect()
    yield client
    await client.close()


async def test_an_operator_approves_compares_and_goes_back(served):
    identification, server, who = served
    operator = who("operator")
    assert await act(who(), VALVE, Action.SHOW) == "V7: no map is approved"
    with pytest.raises(CommandRejected, match="V8: the service has no such valve"):
        await act(who(), "V8", Action.SHOW)
    with pytest.raises(CommandRejected, match=r"V7: the map of RLS is not one .* nothing was"):
        await act(operator, VALVE, Action.APPROVE)
    identification.take(as_changes(plant(600)))
    with pytest.raises(CommandRejected):
        await act(who(), VALVE, Action.APPROVE)
    said = await act(operator, VALVE, Action.APPROVE)
    version = identification.baseline(0).version
    assert said == f"V7: builds on {version}, SHA-256 {identification.baseline(0).digest}"
    for results in identification.results.of([0]):
        await server.publish(results)
    point = [50.0, 100.0, 40.0]
    async with watching(who()) as client:
        ((Q, std, status),) = await client.call("V7.Baseline", "Predict", [["RLS", *point]])
        assert [(Q, std, status)] == await client.call("V7.RLS", "Predict", [point])
        ((*_, far),) = await client.call("V7.Baseline", "Predict", [["RLS", 50.0, 100.0, 300.0]])
        assert (status, far) == (Status.OK, Status.EXTRAPOLATING)
    theta = identification.results.one(0).estimators["RLS"].theta
    identification.take_samples(0, plant(50, seed=9, first=600))
    assert (await act(who(), VALVE, Action.COMPARE, "RLS")).startswith("V7.RLS: ")
    assert await act(operator, VALVE, Action.ROLL_BACK) == said
    assert identification.results.one(0).estimators["RLS"].theta.tolist() == theta.tolist()
    assert await act(operator, VALVE, Action.REPLACED) == "V7: no map is approved"
    identification.take_samples(0, plant(600, first=700))
    identification.do(Command.of("approve", VALVE))
    with pytest.raises(CommandRejected, match="V7 has no estimator 'RML'"):
        await act(who(), VALVE, Action.COMPARE, "RML")


def test_an_action_that_is_none_is_refused(capsys):
    assert run(["baseline", "aprove", "V7"]) == 2
    assert "show, compare, approve, roll-back, replaced" in capsys.readouterr().err
