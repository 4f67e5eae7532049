"""What a client of any stack must find at our results server.

A test module per stack subclasses :class:`ClientInteroperation` and says how to start its program
(see :mod:`support.peer`). Everything goes over Basic256Sha256, SignAndEncrypt.
"""

import asyncio
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from asyncua import ua

from guarded_opcua import (
    OwnCertificate,
    Pki,
    Role,
    UserStore,
    ensure_certificate,
    load_certificate,
    thumbprint,
    trust,
)
from support.peer import PeerError
from support.plant import plant
from support.proxy import Proxy
from support.results import results_settings
from support.users import CHEAP
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Segments
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.nameplate import Nameplate
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.runtime.past import PastKeeper
from valvemap.storage.history import HistoryFile

Codes = ua.StatusCodes
VALVE = f"nsu={NAMESPACE};s=Valvistor"
PASSWORD = "correct horse"
APPLICATION_URI = "urn:test:peer"
SAMPLES = 20  # taken in between two publishings of results
PERIOD_S = 0.05
RECONNECTED_S = 90.0  # attempts of some clients are up to 16 s apart, each with 5 s to be answered


@dataclass
class Stage:
    """A results server at work, and what a client needs to get in."""

    server: ResultsServer
    live: Identification
    proxy: Proxy
    pki: Pki
    own: OwnCertificate
    folder: Path

    def who(self, user="operator", policy="Basic256Sha256", **other):
        return {
            "url": self.server.url,
            "policy": policy,
            "user": user,
            "password": PASSWORD,
            "certificate": str(self.own.certificate),
            "key": str(self.own.key),
            "applicationUri": APPLICATION_URI,
            "server": str(self.pki.own / "service.der"),
            "pki": str(self.folder / "theirs"),
            **other,
        }

    def through_proxy(self):
        return self.who(url=f"opc.tcp://127.0.0.1:{self.proxy.port}/valvemap/service/")


def identification():
    gate, estimators = QualityGate(), {"RLS": RecursiveLeastSquares(FiveTerms())}
    plate = Nameplate(manufacturer="Muster AG", model="V-100", component_name="Valvistor")
    plan = ValvePlan(
        name="Valvistor", gate=gate, estimators=estimators, inverse="RLS", nameplate=plate
    )
    return Identification([plan], Alignment(AlignmentSettings(), optional=(("T",),)))


def taken(first):
    """The samples that come at once, from number ``first``."""
    return plant(SAMPLES, seed=first + 1, first=first)


async def identify(live, server, past):
    """Take samples in and show what they say, 20 times a second; the history keeps both."""
    first = 0
    while True:
        samples = taken(first)
        past.take(ByValve(samples, Segments.one(SAMPLES)))
        live.take_samples(0, samples)
        live.maps.refresh()
        for results in live.results.of([0]):
            await server.publish(results)
            past.note(results)
        past.tick(asyncio.get_running_loop().time())
        first += SAMPLES
        await asyncio.sleep(PERIOD_S)


def double(value):
    return {"type": "Double", "value": value}


def every_sample(node, **more):
    return {"node": f"{VALVE}.{node}", "trigger": "StatusValueTimestamp", **more}


def deadband(node, kind, value):
    return {"node": f"{VALVE}.{node}", "deadband": {"type": kind, "value": value}}


def values(changes):
    return [change["value"] for change in changes]


@asynccontextmanager
async def raised(folder, **more):
    """Set a stage: start everything but the client."""
    pki, theirs = Pki(folder / "server"), Pki(folder / "client")
    own = ensure_certificate(theirs, APPLICATION_URI, ("localhost", "127.0.0.1"), "peer")
    pki.make_folders()
    trust(pki, own.certificate)
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, PASSWORD)
    users.add("observer", Role.OBSERVER, PASSWORD)
    users.add("engineer", Role.ENGINEER, PASSWORD)
    settings = results_settings(users=users, pki=pki, **more)
    live = identification()
    with HistoryFile(folder / "history.sqlite") as store:
        past = PastKeeper(store, ["Valvistor"])
        history = {"past": store, "on_alarm": past.note_alarm}
        async with ResultsServer(settings, live.descriptions(), live, **history) as server:
            task = asyncio.create_task(identify(live, server, past))
            async with Proxy(urlsplit(server.url).port) as proxy:
                yield Stage(server, live, proxy, pki, own, folder)
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            await past.settle()


def missing(counts):
    """Count the results that never came; some clients hand out a burst out of order, or twice."""
    known = set(counts)
    return (max(known) - min(known)) // SAMPLES + 1 - len(known)


def gaps(counts):
    """Count the places at which results are missing, however many are missing there."""
    known = sorted(set(counts))
    return sum(later - earlier > SAMPLES for earlier, later in pairwise(known))


async def goes_on(asking, after):
    """Return the sample counts that come until two seconds' worth of new ones is there."""
    counts = []
    async with asyncio.timeout(RECONNECTED_S):
        while not counts or counts[-1] < after + 2 * SAMPLES / PERIOD_S:
            counts += values((await asking.watch(0.1))[0])
    return counts


class Asking:
    """A peer's connection under a name of its own."""

    def __init__(self, peer, name):
        self._peer, self._name = peer, name

    async def ask(self, op, **fields):
        return await self._peer.ask(op, **{"as": self._name}, **fields)

    async def read(self, node, **more):
        return await self.ask("read", node=f"{VALVE}.{node}", **more)

    async def write(self, node, value):
        answer = await self.ask("write", node=f"{VALVE}.{node}", value=value)
        return answer["code"]

    async def call(self, owner, method, *inputs):
        owner = f"{VALVE}.{owner}"
        return await self.ask("call", owner=owner, method=f"{owner}.{method}", inputs=inputs)

    async def subscribe(self, *items, interval=50):
        return await self.ask("subscribe", items=items, interval=interval)

    async def watch(self, seconds):
        """Return all that came during some seconds, by item."""
        await asyncio.sleep(seconds)
        return await self.ask("changes")

    async def watch_until(self, count):
        """Return all that came until the first item has so many values, by item."""
        first, *others = await self.watch(0.5)
        while len(first) < count:
            for items, more in zip((first, *others), await self.watch(0.5), strict=True):
                items.extend(more)
        return first, *others


class ClientInteroperation:
    """The list that every stack goes through."""

    asks_again = True  # for messages that it has not got: service Republish

    async def test_it_finds_the_valve_where_the_contract_says(self, observer):
        path = [[NAMESPACE, "Identification"], [NAMESPACE, "Valvistor"]]
        found = await observer.ask("follow", node="i=85", path=path)
        assert found == {"code": Codes.Good, "targets": ["Valvistor"]}
        astray = await observer.ask("follow", node="i=85", path=[*path, [NAMESPACE, "Nothing"]])
        assert astray["code"] == Codes.BadNoMatch

    async def test_it_browses_at_once_and_page_by_page(self, observer):
        whole = await observer.ask("browse", node=f"{VALVE}.RLS")
        pages = await observer.ask("browse", node=f"{VALVE}.RLS", page=3)
        assert {"ParameterVector", "Residual", "SampleCount", "Predict"} <= set(whole["names"])
        assert pages["names"] == whole["names"]
        assert whole["pages"] == 1
        assert pages["pages"] == -(-len(whole["names"]) // 3)

    async def test_it_reads_engineering_units_and_enumerations(self, observer):
        units = (await observer.read("RLS.PredictedFlow.EngineeringUnits"))["value"]
        span = (await observer.read("RLS.PredictedFlow.EURange"))["value"]
        names = await observer.read("RLS.Status.EnumStrings")
        axis = (await observer.read("Inverse.Map.XAxisDefinition"))["value"]
        assert (units["unitId"], units["displayName"]) == (19506, "l/min")
        assert (span["low"], span["high"]) == (0, 200)
        assert names["value"][0] == "OK"
        assert axis["title"] == "Pressure drop"
        assert axis["engineeringUnits"]["unitId"] == 4342098

    async def test_it_reads_numbers_arrays_and_parts_of_matrices(self, observer):
        count = await observer.read("RLS.SampleCount")
        vector = await observer.read("RLS.ParameterVector")
        whole = await observer.read("Inverse.Map")
        part = await observer.read("Inverse.Map", range="19:20,0:1")
        assert (count["type"], count["code"]) == ("UInt64", Codes.Good)
        assert (vector["type"], len(vector["value"])) == ("Double", 5)
        assert (whole["dimensions"], len(whole["value"])) == ([21, 20], 420)
        assert part["dimensions"] == [2, 2]
        table = np.array(whole["value"], float).reshape(21, 20)
        np.testing.assert_allclose(np.array(part["value"], float), table[19:, :2].ravel(), rtol=0.1)

    async def test_it_is_told_what_there_is_not(self, observer):
        assert (await observer.read("Nothing"))["code"] == Codes.BadNodeIdUnknown
        beyond = await observer.read("Inverse.Map", range="90:95,0:1")
        assert beyond["code"] == Codes.BadIndexRangeNoData

    async def test_it_sees_the_parameters_move_and_misses_no_result(self, operator):
        made = await operator.subscribe(
            every_sample("RLS.SampleCount"), every_sample("RLS.ParameterVector")
        )
        counts, vectors = await operator.watch_until(15)
        await operator.ask("unsubscribe")
        assert made["interval"] == 50.0
        assert made["items"] == [{"code": 0, "queue": 1000, "sampling": 0.0}] * 2
        assert set(np.diff(values(counts))) == {SAMPLES}
        times = [change["time"] for change in vectors]
        assert set(np.diff(times)) == {SAMPLES * 10}
        assert len({tuple(vector) for vector in values(vectors)}) == len(vectors)
        assert {change["code"] for change in vectors} == {Codes.Good}
        a = np.array(vectors[-1]["value"])
        np.testing.assert_allclose(a[[0, 3, 4]], [3.0, 0.1, -0.02], atol=0.2)

    @pytest.mark.parametrize(("kind", "value"), [("Absolute", 30.0), ("Percent", 15.0)])
    async def test_a_deadband_compares_with_the_last_reported_value(self, operator, kind, value):
        node = "RLS.PredictedFlow"  # its range is 0 to 200 l/min
        await operator.subscribe(every_sample(node), deadband(node, kind, value))
        everything, reported = await operator.watch_until(25)
        await operator.ask("unsubscribe")
        expected = []
        for change in everything:
            if change["time"] < reported[0]["time"]:
                continue
            last = expected[-1] if expected else {"value": np.inf, "code": Codes.Good}
            is_other = change["code"] != last["code"]  # a status is reported whatever the deadband
            if is_other or abs(change["value"] - last["value"]) > 30.0:
                expected.append(change)
        assert 2 <= len(reported) < len(everything)
        assert values(reported) == values(expected)

    async def test_an_item_that_cannot_be_is_refused_by_name_of_the_reason(self, operator):
        made = await operator.subscribe(
            deadband("RLS.SampleCount", "Percent", 5.0),
            deadband("RLS.PredictedFlow", "Percent", 101.0),
            every_sample("RLS.Nothing"),
            every_sample("RLS.Residual", queue=0),
        )
        await operator.ask("unsubscribe")
        codes = [item["code"] for item in made["items"]]
        assert codes[1:] == [Codes.BadDeadbandFilterInvalid, Codes.BadNodeIdUnknown, Codes.Good]
        assert codes[0] in (Codes.BadMonitoredItemFilterUnsupported, Codes.BadFilterNotAllowed)
        assert made["items"][3]["queue"] == 1

    async def test_it_predicts_and_inverts_and_the_two_agree(self, observer):
        inverted = await observer.call("Inverse", "Invert", double(51.0), double(100), double(40))
        predicted = await observer.call("RLS", "Predict", double(50), double(100), double("NaN"))
        U, lower, upper, status = inverted["outputs"]
        assert (inverted["code"], status) == (Codes.Good, 0)
        assert lower <= U <= upper
        assert pytest.approx(50.0, abs=0.5) == U
        assert predicted["outputs"][0] == pytest.approx(51.0, abs=0.5)

    async def test_as_operator_it_commands_an_estimator(self, operator, stage):
        forget = await operator.call("RLS", "SetForgettingFactor", double(0.999))
        assert forget["code"] == Codes.Good
        assert stage.live.valves.lane("Valvistor", "RLS").lam == 0.999
        for command in ("Freeze", "Resume"):
            assert (await operator.call("RLS", command))["code"] == Codes.Good

    async def test_what_it_asks_wrongly_is_named(self, operator):
        text = {"type": "String", "value": "much"}
        wrong = await operator.call("RLS", "SetForgettingFactor", text)
        few = await operator.call("RLS", "SetForgettingFactor")
        elsewhere = await operator.ask(
            "call", owner=f"{VALVE}.Inverse", method=f"{VALVE}.RLS.Reset", inputs=[]
        )
        assert (wrong["code"], wrong["inputs"]) == (
            Codes.BadInvalidArgument,
            [Codes.BadTypeMismatch],
        )
        assert few["code"] == Codes.BadArgumentsMissing
        assert elsewhere["code"] == Codes.BadMethodInvalid

    async def test_as_operator_it_demands_a_flow_and_reads_the_voltage_for_it(self, operator):
        assert await operator.write("Inverse.FlowDemand", double(51.0)) == Codes.Good
        assert await operator.write("Inverse.PressureDrop", double(100.0)) == Codes.Good
        await asyncio.sleep(4 * PERIOD_S)
        required = await operator.read("Inverse.RequiredU")
        assert (required["type"], required["code"]) == ("Double", Codes.Good)
        assert required["value"] == pytest.approx(50.0, abs=0.5)

    async def test_what_it_may_not_write_is_refused_with_the_reason(self, operator):
        assert await operator.write("Inverse.FlowDemand", double(1e6)) == Codes.BadOutOfRange
        text = {"type": "String", "value": "much"}
        assert await operator.write("Inverse.FlowDemand", text) == Codes.BadTypeMismatch
        assert await operator.write("RLS.Residual", double(0.0)) == Codes.BadNotWritable

    async def test_as_observer_it_may_look_but_not_touch(self, observer):
        assert (await observer.call("RLS", "Reset"))["code"] == Codes.BadUserAccessDenied
        denied = await observer.write("Inverse.FlowDemand", double(50.0))
        assert denied == Codes.BadUserAccessDenied

    async def test_a_cut_connection_is_made_again(self, peer, stage):
        cut = Asking(peer, "cut")
        await cut.ask("connect", **stage.through_proxy())
        await cut.subscribe(every_sample("RLS.SampleCount"))
        seen = values((await cut.watch(0.5))[0])
        for _ in range(2):
            stage.proxy.cut()
            seen += await goes_on(cut, after=seen[-1])
        await cut.ask("disconnect")
        assert gaps(seen) <= (0 if self.asks_again else 2)  # a cut loses what is on its way

    async def test_what_was_lost_on_the_line_is_asked_for_again(self, peer, stage):
        asking = Asking(peer, "asking")
        await asking.ask("connect", **stage.through_proxy())
        await asking.subscribe(every_sample("RLS.SampleCount"))
        seen = values((await asking.watch(0.5))[0])
        for _ in range(2):
            stage.proxy.stall()
            await asyncio.sleep(4 * PERIOD_S)
            stage.proxy.cut()
            stage.proxy.flow()
            seen += await goes_on(asking, after=seen[-1])
        await asking.ask("disconnect")
        assert (missing(seen) == 0) == self.asks_again

    async def test_a_stalled_line_loses_nothing(self, peer, stage):
        stalled = Asking(peer, "stalled")
        await stalled.ask("connect", **stage.through_proxy())
        await stalled.subscribe(every_sample("RLS.SampleCount"))
        (seen,) = await stalled.watch(0.5)
        stage.proxy.stall()
        await asyncio.sleep(1.5)
        stage.proxy.flow()
        seen += (await stalled.watch(1.0))[0]
        await stalled.ask("disconnect")
        assert len(seen) >= 20  # a busy machine publishes less
        assert missing(values(seen)) == 0

    async def test_the_stronger_policy_works_too(self, peer, stage):
        strong = Asking(peer, "strong")
        await strong.ask("connect", **stage.who(policy="Aes256_Sha256_RsaPss"))
        await strong.subscribe(every_sample("RLS.Residual"))
        (residuals,) = await strong.watch(0.5)
        assert len(residuals) >= 3
        assert await strong.write("Inverse.FlowDemand", double(51.0)) == Codes.Good
        await strong.ask("disconnect")

    async def test_a_wrong_password_does_not_get_in(self, peer, stage):
        with pytest.raises(PeerError) as refused:
            await peer.ask("connect", **stage.who(password="correct hors"))
        assert refused.value.code == Codes.BadUserAccessDenied

    async def test_a_stranger_is_let_in_once_it_is_trusted(self, peer, stage):
        folder = stage.folder / "stranger"
        own = ensure_certificate(Pki(folder), "urn:test:stranger", ("localhost",), "stranger")
        who = stage.who(
            certificate=str(own.certificate), key=str(own.key), applicationUri="urn:test:stranger"
        )
        stranger = Asking(peer, "stranger")
        with pytest.raises(PeerError):
            await stranger.ask("connect", **who)
        trust(stage.pki, thumbprint(load_certificate(own.certificate)))  # it lies in rejected
        await stranger.ask("connect", **who)
        assert (await stranger.read("RLS.Status"))["code"] == Codes.Good
        await stranger.ask("disconnect")
