"""A valve's nodes are made when somebody first looks at one of them; nobody sees a difference."""

from dataclasses import replace

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import Role, UserStore
from support.clocks import TurnedClock
from support.results import results_of, results_settings
from support.served import patient
from support.users import CHEAP
from valvemap.model.survey import Survey
from valvemap.opcua_results.result_nodes import ResultNodes
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.results import (
    EstimatorDescription,
    EstimatorResult,
    InverseResult,
    ValveDescription,
)
from valvemap.vocabulary.statuses import Quality, Status

pytestmark = pytest.mark.asyncio(loop_scope="module")

T = 1_800_000_000_000_000_000
Codes = ua.StatusCodes
RLS = EstimatorDescription(
    "RLS", "Least squares.", ("a1", "a2"), has_forgetting_factor=True, has_named_parameters=True
)
AUTO = EstimatorDescription("Auto", "By itself.", (), has_forgetting_factor=True)
ALIKE, OTHERS = 40, 3


def described(number):
    if number < ALIKE:
        return ValveDescription(f"V{number}", (RLS,), counters=("late",), map_Q=(0.0, 9.0))
    wide = {"Q_range": (0.0, 10.0 * number), "counters": ("late", "gaps")}
    return ValveDescription(f"V{number}", (AUTO, replace(RLS, parameter_names=("a",))), **wide)


VALVES = tuple(described(number) for number in range(ALIKE + OTHERS))


def result(number):
    """Numbers that say which valve they belong to."""
    survey = Survey(
        U=np.array([50.0]),
        dp=np.array([50.0]),
        std=np.array([[number + 0.5]]),
        age_s=np.array([[1.0]]),
        share=1.0,
        condition=12.0,
        suggested_U=80.0,
        suggested_dp=100.0,
    )
    rls = EstimatorResult(
        t=T + number * 100,
        quality=Quality.GOOD,
        theta=np.array([number + 0.1, number + 0.2][: 2 if number < ALIKE else 1]),
        std=np.array([0.1, 0.2][: 2 if number < ALIKE else 1]),
        predicted=number + 0.3,
        residual=0.5,
        residual_rmse=0.4,
        sample_count=number,
        status=Status.OK,
        survey=survey,
    )
    estimators = {"RLS": rls}
    if number >= ALIKE:
        none = np.empty(0)
        auto = replace(rls, theta=none, std=none, predicted=number + 0.7)
        estimators = {"Auto": auto, "RLS": rls}
    inverse = InverseResult(T, Quality.GOOD, number + 0.4, 0, np.full((1, 1), number))
    counters = {"late": number + 1} | ({"gaps": number + 2} if number >= ALIKE else {})
    return results_of(number, estimators, inverse, **counters)


class Operator:
    """Answers with what it was asked."""

    def predict(self, valve, estimator, U, dp, T):
        return U, 0.1, Status.OK

    def alarms(self, valve):
        return ()

    def __getattr__(self, name):
        return lambda *_: None


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    settings = results_settings(users=users, none_on_loopback=True)
    async with ResultsServer(settings, VALVES, Operator(), TurnedClock(T)) as server:
        for number in range(len(VALVES)):
            await server.publish(result(number))
        client = patient(server.url)
        client.set_user("operator")
        client.set_password(password)
        async with client:
            yield client


async def index_of(client):
    return await client.get_namespace_index(NAMESPACE)


async def node(client, name):
    return client.get_node(ua.NodeId(name, await index_of(client)))


async def value(client, name):
    answer = await (await node(client, name)).read_data_value(raise_on_bad_status=False)
    return answer.Value.Value, answer.StatusCode.value


async def read(client, valve):
    """What a client that reads finds of a valve."""
    names = (
        "RLS.PredictedFlow",
        "RLS.ParameterVector",
        "RLS.Coverage",
        "Inverse.RequiredU",
        "Inverse.Armed",
        "Diagnostics.Late",
        "Diagnostics.SampleAge",
    )
    return [await value(client, f"{valve}.{name}") for name in names]


def published(number):
    theta = [number + 0.1, number + 0.2][: 2 if number < ALIKE else 1]
    return [
        (number + 0.3, Codes.Good),
        (theta, Codes.Good),
        ([[number + 0.5]], Codes.Good),
        (number + 0.4, Codes.Good),
        (False, Codes.Good),
        (number + 1, Codes.Good),
        (None, Codes.BadWaitingForInitialData),
    ]


async def first_reads(client, valve):
    return await value(client, f"{valve}.RLS.ParameterNames")


async def first_browses(client, valve):
    return await (await node(client, valve)).get_children()


async def first_follows_a_path(client, valve):
    index = await index_of(client)
    steps = f"Identification/{valve}/Diagnostics/Late".split("/")
    return await client.nodes.objects.get_child([f"{index}:{step}" for step in steps])


async def first_calls(client, valve):
    method = await node(client, f"{valve}.RLS.Predict")
    return await (await node(client, f"{valve}.RLS")).call_method(method, 5.0, 100.0, np.nan)


async def first_commands(client, valve):
    method = await node(client, f"{valve}.RLS.Reset")
    return await (await node(client, f"{valve}.RLS")).call_method(method)


async def first_demands(client, valve):
    return await (await node(client, f"{valve}.Inverse.FlowDemand")).write_value(1.0)


async def first_subscribes(client, valve):
    class Heard:
        def datachange_notification(self, *_):
            pass

    subscription = await client.create_subscription(100.0, Heard())
    await subscription.subscribe_data_change(await node(client, f"{valve}.RLS.PredictedFlow"))
    await subscription.delete()


LOOKS = (
    first_reads,
    first_browses,
    first_follows_a_path,
    first_calls,
    first_commands,
    first_demands,
    first_subscribes,
)


@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize("first", [3, ALIKE - 1 - len(LOOKS)])
async def test_whatever_the_first_look_is_it_finds_all_that_was_published(client, look, first):
    number = first + LOOKS.index(look)
    await look(client, f"V{number}")
    assert await read(client, f"V{number}") == published(number)
    done = {
        first_commands: "operator: RLS Reset",
        first_demands: "operator: Inverse demand 1 l/min",
    }
    said, _ = await value(client, f"V{number}.Diagnostics.LastAction")
    assert said.startswith(done[look]) if look in done else said == ""


@pytest.mark.parametrize("number", range(ALIKE, ALIKE + OTHERS))
async def test_valves_of_other_estimators_have_their_own_numbers(client, number):
    assert await read(client, f"V{number}") == published(number)
    assert await value(client, f"V{number}.Auto.PredictedFlow") == (number + 0.7, Codes.Good)
    assert await value(client, f"V{number}.Diagnostics.Gaps") == (number + 2, Codes.Good)
    span = await value(client, f"V{number}.RLS.PredictedFlow.EURange")
    assert span[0].High == 10.0 * number


async def test_a_node_that_no_valve_has_is_unknown(client):
    assert (await value(client, "V1.RLS.Nonsense"))[1] == Codes.BadNodeIdUnknown
    assert (await value(client, "V99.RLS.Residual"))[1] == Codes.BadNodeIdUnknown
    assert (await value(client, "V"))[1] == Codes.BadNodeIdUnknown


async def test_a_thousand_valves_are_served_before_their_nodes_are_made(monkeypatch):
    made = []
    add = ResultNodes._add_below

    async def counted(self, folder, valve):
        made.append(valve.name)
        await add(self, folder, valve)

    monkeypatch.setattr(ResultNodes, "_add_below", counted)
    settings = results_settings(none_on_loopback=True)
    valves = [ValveDescription(f"V{k}", (RLS,), counters=("late",)) for k in range(1_000)]
    async with (
        ResultsServer(settings, valves, Operator(), TurnedClock(T)) as server,
        patient(server.url) as client,
    ):
        await server.publish(result(7))
        root = await node(client, "Identification")
        assert len(await root.get_children(nodeclassmask=ua.NodeClass.Object)) == 1_001
        assert not made
        assert await value(client, "V7.RLS.PredictedFlow") == (7.3, Codes.Good)
        assert made == ["V7"]
