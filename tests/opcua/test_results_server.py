import asyncio
from dataclasses import replace

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import Role, ServerError, ServerSettings, UserStore
from support.clocks import TurnedClock
from support.results import results_of, results_settings
from support.served import patient
from support.users import CHEAP
from valvemap.errors import CommandRejected
from valvemap.model.change import Change
from valvemap.model.inversion import Inversion
from valvemap.model.survey import Survey
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.alarm_results import AlarmReport, AlarmResults, Remark
from valvemap.pipeline.recommendation import Recommendation
from valvemap.pipeline.result_ports import Health
from valvemap.pipeline.results import (
    EstimatorDescription,
    EstimatorResult,
    InverseResult,
    SignalResults,
    ValveDescription,
)
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import Adaptation, Quality, Status

pytestmark = pytest.mark.asyncio(loop_scope="module")

T = 1_800_000_000_000_000_000
Codes = ua.StatusCodes
VALVES = (
    ValveDescription(
        name="Valvistor",
        estimators=(
            EstimatorDescription(
                "RLS",
                "Recursive least squares.",
                ("a1", "a2"),
                has_forgetting_factor=True,
                has_named_parameters=True,
            ),
            EstimatorDescription(
                "RBF", "Radial basis functions.", ("w1",), has_forgetting_factor=False
            ),
        ),
        map_Q=(0.0, 100.0, 200.0),
        map_dp=(50.0, 100.0),
        counters=("late", "bad_status"),
    ),
    ValveDescription(
        "V2", (EstimatorDescription("RLS", "Least squares.", ("a1",), has_forgetting_factor=True),)
    ),
    ValveDescription(
        "V3",
        (
            EstimatorDescription("RLS", "", (), has_forgetting_factor=True, finds_changes=True),
            EstimatorDescription(
                "Auto", "", (), has_forgetting_factor=True, chooses_structure=True, finds_lags=True
            ),
        ),
    ),
)
SURVEY = Survey(
    U=np.array([25.0, 75.0]),
    dp=np.array([50.0]),
    std=np.array([[0.5], [1.5]]),
    age_s=np.array([[1.0], [60.0]]),
    share=1.0,
    condition=12.0,
    suggested_U=80.0,
    suggested_dp=100.0,
)
ESTIMATOR = EstimatorResult(
    t=T,
    quality=Quality.GOOD,
    theta=np.array([1.0, -2.5]),
    std=np.array([0.1, np.nan]),
    predicted=50.0,
    residual=0.5,
    residual_rmse=0.4,
    sample_count=2**40,
    status=Status.OK,
    noise_std=0.3,
    survey=SURVEY,
    adaptation=Adaptation.DRIFT,
)
SHORT = replace(ESTIMATOR, theta=np.array([1.0]), std=np.array([0.1]))
WITHOUT_PARAMETERS = replace(ESTIMATOR, theta=np.empty(0), std=np.empty(0))
MAP = np.arange(6.0).reshape(3, 2)
INVERSE = InverseResult(T, Quality.GOOD, 42.0, 0, MAP)


def result(estimator=ESTIMATOR, inverse=INVERSE, **counters):
    other = replace(estimator, theta=estimator.theta[:1], std=estimator.std[:1])
    return results_of(0, {"RLS": estimator, "RBF": other}, inverse, **counters)


CHANGED = AlarmReport(
    name="Changed",
    active=True,
    acked=False,
    severity=600,
    since=T - 2_000_000_000,
    at=T - 1_000_000_000,
    count=1,
    text="The flow changed by -4 l/min.",
)
LAG_FOUND = replace(CHANGED, name="LagFound", active=False, acked=True, since=0, at=0, text="")
ALARMS_OF_A_VALVE = (CHANGED, LAG_FOUND)


class Operator:
    """Remembers what it was asked."""

    def do(self, command):
        return getattr(self, command.action)(*command.arguments)

    def __init__(self):
        self.calls = []

    def reset(self, valve, estimator):
        self.calls.append(("reset", valve, estimator))

    def freeze(self, valve, estimator):
        self.calls.append(("freeze", valve, estimator))

    def resume(self, valve, estimator):
        self.calls.append(("resume", valve, estimator))

    def set_forgetting_factor(self, valve, estimator, lam):
        if estimator == "RBF":
            raise CommandRejected(f"{valve}.{estimator} has no forgetting factor")
        self.calls.append(("forget", valve, estimator, lam))

    def predict(self, valve, estimator, U, dp, T):
        self.calls.append(("predict", valve, estimator, U, dp, T))
        return 10.0 * U, 0.1, Status.UNEXCITED

    def predict_measurement(self, valve, estimator, U, dp, T):
        return 10.0 * U, 10.0 * U - 1.0, 10.0 * U + 1.0, Status.OK

    def invert(self, valve, Q, dp, T):
        self.calls.append(("invert", valve, Q, dp, T))
        columns = (np.array([x]) for x in (Q / 2, Q / 2 - 1, Q / 2 + 1))
        return Inversion(*columns, np.array([1], np.uint8))

    def demand(self, valve, Q, dp):
        self.calls.append(("demand", valve, Q, dp))

    def arm(self, valve):
        if valve != "Valvistor":
            raise CommandRejected(f"{valve}: nodes.required_U is not configured")
        self.calls.append(("arm", valve))

    def disarm(self, valve):
        self.calls.append(("disarm", valve))

    def alarms(self, valve):
        return ALARMS_OF_A_VALVE if valve else ()

    def acknowledge(self, valve, alarm, remark):
        if alarm != "Changed":
            raise CommandRejected(f"{valve}.{alarm}: there is nothing to acknowledge")
        self.calls.append(("acknowledge", valve, alarm, remark))

    def confirm(self, valve, alarm, remark):
        self.calls.append(("confirm", valve, alarm, remark))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served(tmp_path_factory):
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    settings = results_settings(users=users, none_on_loopback=True)
    operator = Operator()
    async with ResultsServer(settings, VALVES, operator, TurnedClock(T)) as server:
        yield server, operator, password


@pytest_asyncio.fixture(loop_scope="module")
async def server(served):
    return served[0]


@pytest_asyncio.fixture(loop_scope="module")
async def operator(served):
    served[1].calls.clear()
    return served[1]


@pytest_asyncio.fixture(loop_scope="module")
async def client(served):
    client = patient(served[0].url)
    client.set_user("operator")
    client.set_password(served[2])
    async with client:
        yield client


@pytest_asyncio.fixture(loop_scope="module")
async def observer(served):
    async with patient(served[0].url) as client:
        yield client


async def node(client, name):
    return client.get_node(ua.NodeId(name, await client.get_namespace_index(NAMESPACE)))


async def value(client, name):
    """(value, StatusCode, source time in UTC ns) of a variable."""
    answer = await (await node(client, name)).read_data_value(raise_on_bad_status=False)
    ticks = ua.datetime_to_win_epoch(answer.SourceTimestamp) - 116_444_736_000_000_000
    return answer.Value.Value, answer.StatusCode.value, ticks * 100


async def called(client, owner, name, *arguments):
    index = await client.get_namespace_index(NAMESPACE)
    return await (await node(client, owner)).call_method(f"{index}:{name}", *arguments)


async def test_signals_and_parameters_are_scalars_beside_the_results(server, observer):
    measured = np.array([[50.0, 200.0, 80.0, 60.0, 120.0, np.nan]])
    newest = SignalResults(np.array([T]), np.array([Quality.GOOD], np.uint8), measured)
    await server.publish(results_of(0, {"RLS": ESTIMATOR}, INVERSE, newest))
    for name, number in zip(("U", "p1", "p2", "Q", "dp"), measured[0, :5], strict=True):
        assert await value(observer, f"Valvistor.Signals.{name}") == (number, Codes.Good, T)
    assert (await value(observer, "Valvistor.Signals.T"))[1] == Codes.BadNoData
    assert await value(observer, "Valvistor.RLS.Parameters.a1") == (1.0, Codes.Good, T)
    assert await value(observer, "Valvistor.RLS.Parameters.a2") == (-2.5, Codes.Good, T)
    unit = await (await node(observer, "Valvistor.Signals.dp")).get_child("0:EngineeringUnits")
    assert (await unit.read_value()).UnitId == 4342098
    for path in ("Valvistor/Signals/Q", "Valvistor/RLS/Parameters/a2"):
        index = await observer.get_namespace_index(NAMESPACE)
        steps = [f"{index}:{step}" for step in f"Identification/{path}".split("/")]
        await observer.nodes.objects.get_child(steps)
    index = await observer.get_namespace_index(NAMESPACE)
    with pytest.raises(ua.uaerrors.BadNoMatch):
        await (await node(observer, "Valvistor.RBF")).get_child(f"{index}:Parameters")


async def test_what_is_waited_for_is_told_and_taken_back(server, observer):
    assert (await value(observer, "V2.Diagnostics.Waiting"))[:2] == ([], Codes.Good)
    for reasons in (("Q has sent no value", "p2 is stamped 3 ms before"), ()):
        await server.publish(results_of(0, {"RLS": ESTIMATOR}, INVERSE, waiting=[reasons]))
        assert (await value(observer, "Valvistor.Diagnostics.Waiting"))[0] == list(reasons)


async def test_the_recommended_estimator_is_named_with_its_reason(server, observer):
    assert (await value(observer, "V2.Recommended"))[1] == Codes.BadWaitingForInitialData
    for said in (Recommendation("RLS", "It is the better one."), Recommendation("", "None yet.")):
        results = results_of(0, {"RLS": ESTIMATOR}, INVERSE)
        await server.publish(replace(results, recommended=[said]))
        assert (await value(observer, "Valvistor.Recommended"))[:2] == (said.name, Codes.Good)
        assert (await value(observer, "Valvistor.RecommendedReason"))[0] == said.reason


async def test_findings_are_sentences_codes_and_probabilities_in_one_order(server, observer):
    lists = [f"Valvistor.Diagnostics.{n}" for n in ("Findings", "FindingCodes")]
    lists.append("Valvistor.Diagnostics.FindingProbabilities")
    play = Finding(FindingCode.PLAY, 0.99, "Play of 2 %.")
    drift = Finding(FindingCode.GAIN_DRIFT, 0.75, "The gain falls.")
    for found in ((play, drift), ()):
        results = results_of(0, {"RLS": ESTIMATOR}, INVERSE)
        await server.publish(replace(results, findings=[found]))
        sentences, codes, chances = [(await value(observer, id_))[0] for id_ in lists]
        assert sentences == [one.sentence for one in found]
        assert codes == [one.code for one in found]
        assert chances == [one.probability for one in found]
    texts = await (await (await node(observer, lists[1])).get_child("0:EnumStrings")).read_value()
    assert [text.Text for text in texts] == [code.name for code in FindingCode]


@pytest.mark.parametrize(
    ("quality", "code"),
    [(Quality.UNCERTAIN, Codes.Uncertain), (Quality.BAD, Codes.Bad)],
)
async def test_a_signal_is_as_good_as_its_source_says(server, observer, quality, code):
    one = np.ones((1, 6))
    newest = SignalResults(np.array([T]), np.array([quality], np.uint8), one)
    await server.publish(results_of(0, {"RLS": ESTIMATOR}, INVERSE, newest))
    assert (await value(observer, "Valvistor.Signals.Q"))[1] == code


async def test_before_any_result_everything_waits(observer):
    for name in ("PredictedFlow", "ParameterVector", "SampleCount", "Status"):
        assert (await value(observer, f"V2.RLS.{name}"))[:2] == (
            None,
            Codes.BadWaitingForInitialData,
        )
    assert (await value(observer, "V2.Signals.Q"))[1] == Codes.BadWaitingForInitialData
    assert (await value(observer, "V2.RLS.ParameterNames"))[:2] == (["a1"], Codes.Good)


@pytest.mark.parametrize(
    "path",
    [
        "Identification/Valvistor/RLS/ParameterVector",
        "Identification/Valvistor/RBF/Status",
        "Identification/Valvistor/RLS/Predict",
        "Identification/Valvistor/Inverse/FlowDemand",
        "Identification/Valvistor/Inverse/Map",
        "Identification/Valvistor/Inverse/Invert",
        "Identification/Valvistor/Inverse/Armed",
        "Identification/Valvistor/Inverse/FeedForwardStatus",
        "Identification/Valvistor/Inverse/Arm",
        "Identification/Valvistor/Inverse/Disarm",
        "Identification/V2/Inverse/RequiredU",
        "Identification/V2/Diagnostics/SampleAge",
        "Identification/Service/Checkpoint/Age",
    ],
)
async def test_paths_lead_to_the_ids_of_the_contract(observer, path):
    index = await observer.get_namespace_index(NAMESPACE)
    found = await observer.nodes.objects.get_child([f"{index}:{name}" for name in path.split("/")])
    name = path.removeprefix("Identification/").replace("/", ".")
    assert found.nodeid == ua.NodeId(name, index)
    assert (await found.read_browse_name()).Name == name.rpartition(".")[2]
    assert len((await found.read_description()).Text) > 8


async def test_a_result_is_read_as_it_was_published(server, observer):
    await server.publish(result(late=3))
    expected = {
        "RLS.ParameterVector": [1.0, -2.5],
        "RLS.ParameterNames": ["a1", "a2"],
        "RLS.PredictedFlow": 50.0,
        "RLS.Residual": 0.5,
        "RLS.ResidualRmse": 0.4,
        "RLS.NoiseStd": 0.3,
        "RLS.Coverage": [[0.5], [1.5]],
        "RLS.CoverageAge": [[1.0], [60.0]],
        "RLS.CoverageShare": 1.0,
        "RLS.Conditioning": 12.0,
        "RLS.SuggestedU": 80.0,
        "RLS.SuggestedDp": 100.0,
        "RLS.SampleCount": 2**40,
        "RLS.Status": 0,
        "RLS.Adaptation": 3,
        "Inverse.RequiredU": 42.0,
        "Inverse.RequiredUStatus": 0,
        "Inverse.Map": MAP.tolist(),
        "Inverse.MapQ": [0.0, 100.0, 200.0],
        "Inverse.MapDp": [50.0, 100.0],
        "Diagnostics.Late": 3,
    }
    for name, wanted in expected.items():
        assert await value(observer, f"Valvistor.{name}") == (wanted, Codes.Good, T), name
    first, second = (await value(observer, "Valvistor.RLS.ParameterStd"))[0]
    assert first == 0.1
    assert np.isnan(second)


async def test_a_frame_holds_all_numbers_of_a_valve_under_their_names(server, observer):
    names = (await value(observer, "Valvistor.FrameNames"))[0]
    for _ in range(2):
        await server.publish(result())
    numbers, code, t = await value(observer, "Valvistor.Frame")
    frame = dict(zip(names, numbers, strict=True))
    assert (code, t) == (Codes.Good, T)
    assert frame["RLS.PredictedFlow"] == 50.0
    assert frame["RBF.SampleCount"] == 2**40
    assert frame["RLS.ParameterVector.a2"] == -2.5
    assert frame["Inverse.RequiredU"] == 42.0
    before = frame["Sequence"]
    await server.publish(result())
    assert (await value(observer, "Valvistor.Frame"))[0][0] == before + 1


async def test_lost_sensors_leave_nothing_good(server, observer):
    await server.publish(result())
    lost = replace(ESTIMATOR, quality=Quality.BAD)
    await server.publish(result(lost, replace(INVERSE, quality=Quality.BAD)))
    for name in ("RLS.ParameterVector", "RLS.PredictedFlow", "Inverse.RequiredU", "Inverse.Map"):
        shown = await value(observer, f"Valvistor.{name}")
        assert shown == (None, Codes.BadNoCommunication, T), name
    assert await value(observer, "Valvistor.RLS.Status") == (0, Codes.UncertainLastUsableValue, T)
    await server.publish(result())
    assert (await value(observer, "Valvistor.Inverse.Map"))[0] == MAP.tolist()


async def test_what_has_become_old_is_uncertain_at_once_and_counters_stay(server, observer):
    await server.publish(result(late=3))
    await server.publish(results_of(1, {"RLS": SHORT}, INVERSE))
    old = Codes.UncertainLastUsableValue
    for name in ("RLS.PredictedFlow", "RLS.SampleCount", "RBF.ParameterVector", "Frame"):
        assert (await value(observer, f"Valvistor.{name}"))[1:] == (Codes.Good, T), name
    before = await value(observer, "Valvistor.RLS.ParameterVector")
    missing = await value(observer, "Valvistor.RLS.SystematicStd")
    await server.doubt(np.array([0]))
    assert await value(observer, "Valvistor.RLS.ParameterVector") == (before[0], old, T)
    assert await value(observer, "Valvistor.RLS.SystematicStd") == missing
    for name in ("RLS.PredictedFlow", "RLS.SampleCount", "RBF.ParameterVector", "Frame"):
        assert (await value(observer, f"Valvistor.{name}"))[1:] == (old, T), name
    assert (await value(observer, "Valvistor.Diagnostics.Late"))[1] == Codes.Good
    assert (await value(observer, "V2.RLS.PredictedFlow"))[1] == Codes.Good


async def test_counters_are_told_as_they_grow(server, observer):
    await server.publish(result(late=4, bad_status=1))
    assert (await value(observer, "Valvistor.Diagnostics.BadStatus"))[0] == 1
    await server.publish(result(late=5, bad_status=1))
    assert (await value(observer, "Valvistor.Diagnostics.Late"))[0] == 5


async def test_the_service_s_own_condition_is_shown(server, observer):
    health = Health(
        age_s=np.array([0.25, np.nan, 2.0]),
        waiting=np.array([3, 0, 0]),
        source=SourceCounters(
            100, 10, missing_messages=2, overflows=4, undecodable=1, from_history=6
        ),
        source_states=("north: connected", "south: away"),
        checkpoint_age_s=1.5,
        checkpoint_failures=7,
        checkpoint_bytes=4096,
    )
    await server.show_health(health)
    assert (await value(observer, "Valvistor.Diagnostics.SampleAge"))[:2] == (0.25, Codes.Good)
    unknown = Codes.BadWaitingForInitialData
    assert (await value(observer, "V2.Diagnostics.SampleAge"))[1] == unknown
    assert (await value(observer, "Valvistor.Diagnostics.Pending"))[0] == 3
    shown = {
        "Checkpoint.Age": 1.5,
        "Checkpoint.Failures": 7,
        "Checkpoint.Size": 4096,
        "Source.Notifications": 100,
        "Source.Overflows": 4,
        "Source.MissingMessages": 2,
        "Source.Undecodable": 1,
        "Source.FromHistory": 6,
        "Source.States": ["north: connected", "south: away"],
    }
    for name, expected in shown.items():
        assert (await value(observer, f"Service.{name}"))[:2] == (expected, Codes.Good)


async def test_units_ranges_and_names_of_values_are_there(observer):
    flow = await node(observer, "Valvistor.RLS.PredictedFlow")
    units = await (await flow.get_child("0:EngineeringUnits")).read_value()
    span = await (await flow.get_child("0:EURange")).read_value()
    assert (units.UnitId, units.DisplayName.Text) == (19506, "l/min")
    assert (span.Low, span.High) == (0.0, 200.0)
    status = await node(observer, "Valvistor.RLS.Status")
    texts = await (await status.get_child("0:EnumStrings")).read_value()
    assert [text.Text for text in texts] == [member.name for member in Status]


async def test_the_map_is_an_image_that_describes_its_axes(observer):
    image = await node(observer, "Valvistor.Inverse.Map")
    assert await image.read_type_definition() == ua.NodeId(12047)
    assert await image.read_array_dimensions() == [3, 2]
    x = await (await image.get_child("0:XAxisDefinition")).read_value()
    y = await (await image.get_child("0:YAxisDefinition")).read_value()
    assert (x.AxisSteps, x.EngineeringUnits.DisplayName.Text) == ([50.0, 100.0], "bar")
    assert (y.AxisSteps, y.EngineeringUnits.DisplayName.Text) == ([0.0, 100.0, 200.0], "l/min")


async def test_everyone_may_predict_and_invert(observer, operator):
    assert await called(observer, "Valvistor.RLS", "Predict", 50.0, 100.0, 40.0) == [500.0, 0.1, 2]
    answer = await called(observer, "Valvistor.RLS", "PredictMeasurement", 50.0, 100.0, np.nan)
    assert answer == [500.0, 499.0, 501.0, 0]
    answer = await called(observer, "Valvistor.Inverse", "Invert", 80.0, 100.0, 40.0)
    assert answer == [40.0, 39.0, 41.0, 1]
    assert operator.calls == [
        ("predict", "Valvistor", "RLS", 50.0, 100.0, 40.0),
        ("invert", "Valvistor", 80.0, 100.0, 40.0),
    ]


@pytest.mark.parametrize("method", ["Reset", "Freeze", "Resume"])
async def test_commands_reach_the_operator_port(client, operator, method):
    await called(client, "Valvistor.RBF", method)
    assert operator.calls == [(method.lower(), "Valvistor", "RBF")]


@pytest.mark.parametrize("method", ["Reset", "Freeze", "Resume"])
async def test_an_observer_commands_nothing(observer, operator, method):
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await called(observer, "Valvistor.RLS", method)
    assert operator.calls == []


async def test_arming_is_the_operators_and_shows_at_once(client, observer, operator):
    assert (await value(observer, "Valvistor.Inverse.Armed"))[:2] == (False, Codes.Good)
    for method, armed in (("Arm", True), ("Disarm", False)):
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            await called(observer, "Valvistor.Inverse", method)
        assert operator.calls == []
        await called(client, "Valvistor.Inverse", method)
        assert operator.calls == [(method.lower(), "Valvistor")]
        assert (await value(observer, "Valvistor.Inverse.Armed"))[0] is armed
        operator.calls.clear()
    with pytest.raises(ua.uaerrors.BadInvalidState):
        await called(client, "V2.Inverse", "Arm")
    assert (await value(observer, "V2.Inverse.Armed"))[0] is False
    with pytest.raises(ua.uaerrors.BadNotWritable):
        await (await node(client, "Valvistor.Inverse.Armed")).write_value(value=True)


async def test_why_nothing_is_written_is_good_though_the_sensors_are_lost(server, observer):
    lost = replace(INVERSE, quality=Quality.BAD, armed=True, feed_forward=FeedForwardStatus.STALE)
    await server.publish(result(inverse=lost))
    status = await value(observer, "Valvistor.Inverse.FeedForwardStatus")
    assert status[:2] == (FeedForwardStatus.STALE, Codes.Good)
    assert (await value(observer, "Valvistor.Inverse.Armed"))[:2] == (True, Codes.Good)
    texts = await (await node(observer, "Valvistor.Inverse.FeedForwardStatus")).get_child(
        "0:EnumStrings"
    )
    assert [text.Text for text in await texts.read_value()][5] == "STALE"
    await server.publish(result())
    assert (await value(observer, "Valvistor.Inverse.Armed"))[0] is False


async def test_a_forgetting_factor_is_checked_and_passed_on(client, operator):
    await called(client, "Valvistor.RLS", "SetForgettingFactor", 0.99)
    assert operator.calls == [("forget", "Valvistor", "RLS", 0.99)]
    for lam in (0.0, -0.5, 1.01):
        with pytest.raises(ua.uaerrors.BadOutOfRange):
            await called(client, "Valvistor.RLS", "SetForgettingFactor", lam)
    with pytest.raises(ua.uaerrors.BadInvalidState):
        await called(client, "Valvistor.RBF", "SetForgettingFactor", 0.99)
    with pytest.raises(ua.uaerrors.BadInvalidArgument):
        await called(client, "Valvistor.RLS", "SetForgettingFactor", "much")
    assert len(operator.calls) == 1


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ((50.0, 100.0), ua.uaerrors.BadArgumentsMissing),
        ((50.0, 100.0, 40.0, 1.0), ua.uaerrors.BadTooManyArguments),
        ((50, 100.0, 40.0), ua.uaerrors.BadInvalidArgument),
        ((101.0, 100.0, 40.0), ua.uaerrors.BadInvalidArgument),
        ((50.0, float("nan"), 40.0), ua.uaerrors.BadInvalidArgument),
    ],
)
async def test_wrong_arguments_are_refused_by_name(observer, operator, arguments, error):
    with pytest.raises(error):
        await called(observer, "Valvistor.RLS", "Predict", *arguments)
    assert operator.calls == []


async def test_an_unknown_temperature_is_nan(observer, operator):
    await called(observer, "Valvistor.RLS", "Predict", 50.0, 100.0, float("nan"))
    *_, T = operator.calls[-1]
    assert np.isnan(T)


async def test_a_demand_is_taken_back_by_nan(client, operator):
    await (await node(client, "V2.Inverse.FlowDemand")).write_value(float("nan"))
    assert np.isnan(operator.calls[-1][2])


async def test_flow_and_pressure_make_a_demand_together(client, operator):
    await (await node(client, "V2.Inverse.FlowDemand")).write_value(80.0)
    await (await node(client, "V2.Inverse.PressureDrop")).write_value(120.0)
    (_, valve, Q, dp), last = operator.calls
    assert (valve, Q) == ("V2", 80.0)
    assert np.isnan(dp)
    assert last == ("demand", "V2", 80.0, 120.0)
    assert (await value(client, "V2.Inverse.FlowDemand"))[:2] == (80.0, Codes.Good)


async def test_a_demand_from_before_a_restart_is_shown_and_stands(server, client, operator):
    server.show_demands({"V2": (80.0, 120.0)})
    for name, wanted in (("FlowDemand", 80.0), ("PressureDrop", 120.0)):
        assert (await value(client, f"V2.Inverse.{name}"))[:2] == (wanted, Codes.Good)
    await (await node(client, "V2.Inverse.FlowDemand")).write_value(70.0)
    assert operator.calls[-1] == ("demand", "V2", 70.0, 120.0)


async def test_what_was_done_last_is_shown_with_who_did_it(client, observer, operator):
    last = "V3.Diagnostics.LastAction"
    assert (await value(observer, last))[0] == ""
    await called(client, "V3.RLS", "SetForgettingFactor", 0.995)
    done = "operator: RLS SetForgettingFactor 0.995"
    assert await value(observer, last) == (done, Codes.Good, T)
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await called(observer, "V3.RLS", "Freeze")
    with pytest.raises(ua.uaerrors.BadInvalidState):
        await called(client, "V3.Inverse", "Arm")
    assert (await value(observer, last))[0] == done
    await (await node(client, "V3.Inverse.FlowDemand")).write_value(80.0)
    assert (await value(observer, last))[0] == "operator: Inverse demand 80 l/min at nan bar"


async def test_a_demand_beyond_the_range_is_refused(client, operator):
    with pytest.raises(ua.uaerrors.BadOutOfRange):
        await (await node(client, "V2.Inverse.FlowDemand")).write_value(500.0)
    assert operator.calls == []


async def test_an_observer_demands_nothing_and_nobody_writes_results(observer, client, operator):
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await (await node(observer, "V2.Inverse.FlowDemand")).write_value(80.0)
    with pytest.raises(ua.uaerrors.BadNotWritable):
        await (await node(client, "V2.Inverse.RequiredU")).write_value(80.0)
    assert operator.calls == []


async def test_a_subscriber_sees_every_result_with_its_time(server, observer):
    seen = asyncio.Queue()

    class Handler:
        def datachange_notification(self, _node, number, data):
            seen.put_nowait((number, data.monitored_item.Value.SourceTimestamp))

    subscription = await observer.create_subscription(50, Handler())
    await subscription.subscribe_data_change(
        await node(observer, "Valvistor.RLS.Residual"), queuesize=100
    )
    await asyncio.wait_for(seen.get(), 5)
    for k in range(5):
        await server.publish(result(replace(ESTIMATOR, residual=float(k), t=T + k * 10_000_000)))
    got = [await asyncio.wait_for(seen.get(), 5) for _ in range(5)]
    assert [number for number, _ in got] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert len({time for _, time in got}) == 5
    await subscription.delete()


async def test_a_port_in_use_is_named(served, tmp_path):
    settings = ServerSettings(
        url=served[0].url,
        application_uri="urn:test:other",
        application_name="other",
        namespace_uri=NAMESPACE,
        none_on_loopback=True,
    )
    other = ResultsServer(settings, [], Operator())
    with pytest.raises(ServerError, match="cannot listen"):
        await other.start()
    await other.publish(result())
    await other.stop()


async def test_a_change_that_was_found_is_told_with_its_time_and_size(server, observer):
    await server.publish(results_of(2, {"RLS": WITHOUT_PARAMETERS}, INVERSE))
    assert (await value(observer, "V3.RLS.ChangeCount"))[:2] == (0, Codes.Good)
    assert (await value(observer, "V3.RLS.ChangeTime"))[1] == Codes.BadNoData
    assert (await value(observer, "V3.RLS.ChangeSize"))[1] == Codes.BadNoData
    changed = replace(
        WITHOUT_PARAMETERS, change=Change(count=1, sample=700, t=T - 5_000_000_000, size=-4.5)
    )
    await server.publish(results_of(2, {"RLS": changed}, INVERSE))
    assert (await value(observer, "V3.RLS.ChangeCount"))[:2] == (1, Codes.Good)
    assert (await value(observer, "V3.RLS.ChangeSize"))[:2] == (-4.5, Codes.Good)
    moment, code, _ = await value(observer, "V3.RLS.ChangeTime")
    assert code == Codes.Good
    assert ua.datetime_to_win_epoch(moment) * 100 == T - 5_000_000_000 + 11_644_473_600_000_000_000


async def test_lags_that_were_found_stand_with_the_valves_diagnostics(server, observer):
    found = replace(WITHOUT_PARAMETERS, lags=(0.03, 0.2))
    await server.publish(results_of(2, {"Auto": found}, INVERSE))
    assert (await value(observer, "V3.Diagnostics.LagU"))[:2] == (0.03, Codes.Good)
    assert (await value(observer, "V3.Diagnostics.LagQ"))[:2] == (0.2, Codes.Good)
    with pytest.raises(ua.UaStatusCodeError):
        await (await node(observer, "V1.Diagnostics.LagQ")).read_value()


async def test_a_structure_that_was_chosen_is_told_in_words(server, observer):
    chosen = replace(WITHOUT_PARAMETERS, structure="spline, 4 x 3 cells, dead band 6 %")
    await server.publish(results_of(2, {"Auto": chosen}, INVERSE))
    assert (await value(observer, "V3.Auto.Structure"))[:2] == (chosen.structure, Codes.Good)
    with pytest.raises(ua.UaStatusCodeError):
        await (await node(observer, "V3.Auto.ChangeCount")).read_value()


def alarms_of(valve, *alarms, version=1):
    found = AlarmResults(np.array([version]), lambda _m: alarms)
    lanes = {"RLS": replace(ESTIMATOR, theta=np.ones(1), std=np.ones(1))}
    return replace(results_of(valve, lanes, INVERSE), alarms=found)


async def test_an_alarm_stands_as_plain_tags_before_and_after_it_comes(server, observer):
    prefix = "V2.Alarms.LagFound"
    assert await value(observer, f"{prefix}.Active") == (False, Codes.Good, T)
    assert await value(observer, f"{prefix}.Acked") == (True, Codes.Good, T)
    assert await value(observer, f"{prefix}.Text") == ("", Codes.Good, T)
    assert (await value(observer, f"{prefix}.Since"))[:2] == (None, Codes.BadNoData)
    came = replace(LAG_FOUND, active=True, acked=False, since=T - 10**9, at=T, text="It lags.")
    await server.publish(alarms_of(1, came))
    assert await value(observer, f"{prefix}.Active") == (True, Codes.Good, T)
    assert await value(observer, f"{prefix}.Acked") == (False, Codes.Good, T)
    assert await value(observer, f"{prefix}.Severity") == (600, Codes.Good, T)
    assert await value(observer, f"{prefix}.Text") == ("It lags.", Codes.Good, T)
    since, code, _ = await value(observer, f"{prefix}.Since")
    assert (ua.datetime_to_win_epoch(since), code) == (
        (T - 10**9) // 100 + 116_444_736_000_000_000,
        Codes.Good,
    )
    kinds = {
        name: (await (await node(observer, f"{prefix}.{name}")).read_data_type_as_variant_type())
        for name in ("Active", "Severity", "Since", "Text", "Acked")
    }
    types = ua.VariantType
    assert list(kinds.values()) == [
        types.Boolean,
        types.UInt16,
        types.DateTime,
        types.String,
        types.Boolean,
    ]


async def test_operators_acknowledge_and_observers_do_not(client, observer, operator):
    comment = ua.Variant("seen", ua.VariantType.String)
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await called(observer, "Valvistor.Alarms.Changed", "Acknowledge", comment)
    await called(client, "Valvistor.Alarms.Changed", "Acknowledge", comment)
    said = Remark("seen", "operator", T)
    assert operator.calls == [("acknowledge", "Valvistor", "Changed", said)]
    said = (await value(observer, "Valvistor.Diagnostics.LastAction"))[0]
    assert said == "operator: Alarms.Changed Acknowledge 'seen'"
    with pytest.raises(ua.uaerrors.BadInvalidState):
        await called(client, "Valvistor.Alarms.LagFound", "Acknowledge", comment)
