"""The results server of a fleet: what came is shown, what is asked for is done by a worker."""

import asyncio
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from asyncua import ua

from guarded_opcua import Role, UserStore
from support.fleet import RHYTHM, Dictionary, block, catalogue
from support.plant import START
from support.results import results_settings
from support.served import patient
from valvemap.clock import ManualClock
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.commands import is_reply, read_reply, write_message
from valvemap.kafka.group import Group
from valvemap.kafka.mirror import Mirror
from valvemap.kafka.reading import Heard
from valvemap.kafka.rejections import Rejection
from valvemap.kafka.result_blocks import read_results
from valvemap.kafka.settings import FleetConfig, ServeConfig
from valvemap.kafka.site_results import Show
from valvemap.kafka.worker import MEMORY, Worker
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.vocabulary.statuses import Quality, Status

VALVES, GROUPS = 5, ("north.0", "north.1")
CONFIG = FleetConfig(serve=ServeConfig(stale_after_s=5.0, answer_s=2.0))
GOOD, UNCERTAIN, BAD = 0, 0x4000_0000, 0x8000_0000


@pytest.fixture(scope="module")
def known():
    return catalogue(VALVES)


class Wire:
    """Both ends of the topics: a worker that learns at once, and what `serve` reads and sends."""

    def __init__(self, known):
        self._worker = Worker(known, RHYTHM)
        self._known = known
        self.stores = {name: Dictionary() for name in GROUPS}
        self._heard = Heard()
        self.deaf = False
        self.numbers = dict.fromkeys(GROUPS, 0)

    def learn(self, group, n=25):
        number = self.numbers[group] = self.numbers[group] + 1
        plan = self._known.groups[group]
        lengths = [n] * len(plan.plans)
        one = block(plan, number, lengths, seed=number, first=number * n)
        self._out(self._worker.samples(group.encode(), write_samples(one), self.stores[group]))

    def poison(self, group, message):
        self._out(self._worker.samples(group.encode(), message, self.stores[group]))

    def send(self, command, refused):
        if self.deaf:
            return
        store = self.stores.get(command.group)
        if store is None:
            refused("not sent: there is nobody")
            return
        self._out(self._worker.command(command.group.encode(), write_message(command), store))

    def _out(self, messages):
        self._worker.keep()
        self._heard.rejected += [
            Rejection.from_headers(letter.key, letter.headers(None), 0)
            for letter in self._worker.rejected()
        ]
        for message in messages:
            if is_reply(message):
                self._heard.replies.append(read_reply(message))
            else:
                self._heard.results.append(read_results(message))

    def read(self):
        heard, self._heard = self._heard, Heard()
        return heard

    def tend(self):
        pass

    def commit(self):
        pass


@asynccontextmanager
async def served(known, wire, clock=None, blocks=()):
    groups = {name: Group(plan, 1) for name, plan in known.groups.items()}
    show = Show(known, "north", CONFIG, groups, wire, clock=clock)
    descriptions = [d for g in groups.values() for d in g.identification.descriptions()]
    users, password = UserStore.one_time("operator", Role.OPERATOR)
    settings = results_settings(users=users, none_on_loopback=True)
    server = ResultsServer(settings, descriptions, show.operator)
    async with server:
        await show.first(server, blocks)
        running = asyncio.create_task(show.run(server, wire, asyncio.Event()))
        client = patient(server.url)
        client.set_user("operator")
        client.set_password(password)
        try:
            async with client:
                yield show, client
        finally:
            running.cancel()
            with suppress(asyncio.CancelledError):
                await running


def node(client, name):
    return client.get_node(ua.NodeId(name, 2))


async def value(client, name):
    return (await node(client, name).read_data_value(raise_on_bad_status=False)).Value.Value


async def code(client, name):
    return (await node(client, name).read_data_value(raise_on_bad_status=False)).StatusCode.value


async def until(condition, seconds=20.0):
    async with asyncio.timeout(seconds):
        while not await condition():  # noqa: ASYNC110
            await asyncio.sleep(0.02)


async def call(client, name, *values):
    return await node(client, name.rpartition(".")[0]).call_method(ua.NodeId(name, 2), *values)


def memory_of(known, wire, group):
    found = Group(known.groups[group], 1)
    found.remember(wire.stores[group].get_bytes(MEMORY))
    return found.identification


async def test_results_of_all_groups_are_shown_as_they_come(known):
    wire = Wire(known)
    async with served(known, wire) as (_, client):
        assert await code(client, "V4.RLS.ParameterVector") & 0xC000_0000 == BAD
        for group in GROUPS:
            wire.learn(group)
            wire.learn(group)

        async def all_there():
            counts = [await value(client, f"V{k}.RLS.SampleCount") for k in range(VALVES)]
            return counts == [50] * VALVES

        await until(all_there)
        for k in range(VALVES):
            learnt = memory_of(known, wire, GROUPS[k // 3]).valves.lane(f"V{k}", "RML")
            theta, _ = learnt.estimator.parameters(learnt.state)
            np.testing.assert_array_equal(await value(client, f"V{k}.RML.ParameterVector"), theta)
        assert len(await value(client, "V1.Inverse.Map")) > 0
        assert await value(client, "V1.Signals.Q") is not None
        assert await value(client, "V1.Alarms.Changed.Active") is False


async def test_what_an_operator_does_is_done_by_a_worker_and_answered_when_it_is(known):
    wire = Wire(known)
    async with served(known, wire) as (_, client):
        for _ in range(4):
            wire.learn(GROUPS[1], 60)

        async def learnt():
            return await value(client, "V3.RLS.SampleCount") == 240

        await until(learnt)
        await call(client, "V3.RLS.Freeze")
        assert memory_of(known, wire, GROUPS[1]).valves.lane("V3", "RLS").frozen
        await call(client, "V3.RML.SetForgettingFactor", 0.99)
        assert memory_of(known, wire, GROUPS[1]).valves.lane("V3", "RML").lam == 0.99
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await call(client, "V3.Baseline.RollBack")
        assert refused.value.code == ua.StatusCodes.BadInvalidState
        assert "no baseline" in await value(client, "V3.Baseline.LastRefusal")
        await call(client, "V3.Baseline.Approve")

        async def approved():
            return bool(await value(client, "V3.Baseline.Version"))

        await until(approved)
        mean, largest, *_, points = await call(client, "V3.Baseline.Compare", "RLS")
        assert (mean, largest) == (0.0, 0.0)
        assert points > 0
        assert "Baseline Approve" in await value(client, "V3.Diagnostics.LastAction")
        with pytest.raises(ua.UaStatusCodeError):
            await call(client, "V3.Inverse.Arm")
        with pytest.raises(ua.UaStatusCodeError):
            await call(client, "V3.Alarms.Changed.Acknowledge", "seen")


async def test_questions_are_answered_with_what_the_worker_knows(known):
    wire = Wire(known)
    async with served(known, wire) as (_, client):
        for _ in range(4):
            wire.learn(GROUPS[0], 60)
        own = memory_of(known, wire, GROUPS[0])
        Q, std, status = await call(client, "V1.RLS.Predict", 50.0, 80.0, np.nan)
        assert (Q, std, Status(status)) == own.predict("V1", "RLS", 50.0, 80.0, np.nan)
        found = await call(client, "V1.RLS.PredictMeasurement", 50.0, 80.0, 40.0)
        assert tuple(found) == own.predict_measurement("V1", "RLS", 50.0, 80.0, 40.0)
        U, *_ = await call(client, "V1.Inverse.Invert", 40.0, 80.0, np.nan)
        assert own.invert("V1", 40.0, 80.0, np.nan).U[0] == U


async def test_a_demand_is_written_when_a_worker_has_it_and_its_answer_is_shown(known):
    wire = Wire(known)
    async with served(known, wire) as (_, client):
        for _ in range(4):
            wire.learn(GROUPS[0], 60)
        write = ua.DataValue(ua.Variant(80.0, ua.VariantType.Double))
        await node(client, "V0.Inverse.PressureDrop").write_value(write)
        write = ua.DataValue(ua.Variant(40.0, ua.VariantType.Double))
        await node(client, "V0.Inverse.FlowDemand").write_value(write)
        own = memory_of(known, wire, GROUPS[0])
        expected, _ = own.answers.required(0)

        async def answered():
            return await value(client, "V0.Inverse.RequiredU") == expected.U

        await until(answered)


async def test_where_no_worker_answers_the_operator_is_told_so(known):
    wire = Wire(known)
    async with served(known, wire) as (show, client):
        wire.deaf = True
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await call(client, "V0.RLS.Reset")
        assert refused.value.code == ua.StatusCodes.BadInvalidState
        assert not show.operator._asked


async def test_silence_makes_results_uncertain_then_bad_and_news_makes_them_good(known):
    wire, clock = Wire(known), ManualClock(START)
    async with served(known, wire, clock) as (_, client):
        for _ in range(4):
            wire.learn(GROUPS[0], 60)
        name = "V0.RLS.PredictedFlow"

        def is_(severity):
            async def found():
                return await code(client, name) & 0xC000_0000 == severity

            return found

        await until(is_(GOOD))
        clock.advance(6.0)
        await until(is_(UNCERTAIN))
        clock.advance(5.0)
        await until(is_(BAD))
        wire.learn(GROUPS[0], 60)
        await until(is_(GOOD))


async def test_rejected_messages_raise_the_services_alarm_until_none_came_for_a_while(known):
    wire, clock = Wire(known), ManualClock(START)
    name = "Service.Alarms.MessagesRejected"
    async with served(known, wire, clock) as (show, client):

        def is_(active, *words):
            async def found():
                clock.advance(0.5)  # the alarms are judged once a second
                is_active = await value(client, f"{name}.Active")
                text = await value(client, f"{name}.Text")
                return is_active is active and all(word in text for word in words)

            return found

        wire.learn(GROUPS[0])
        await until(is_(False))
        wire.poison(GROUPS[0], b"nonsense")
        await until(is_(True, "1 message was rejected (north.0: ", "Arrow"))
        assert await value(client, f"{name}.Acked") is False
        wire.poison(GROUPS[1], b"nonsense")
        await until(is_(True, "2 messages were rejected (north.1: "))
        show._note("north.1", RuntimeError("not shown"))
        await until(is_(True, "3 messages were rejected (north.1: unexpected RuntimeError"))
        await call(client, f"{name}.Acknowledge", "seen")
        await until(lambda: value(client, f"{name}.Acked"))
        clock.advance(CONFIG.serve.rejected_quiet_s)
        await until(is_(False))
        wire.poison(GROUPS[0], b"nonsense")
        await until(is_(True, "1 message was rejected (north.0: "))
        assert await value(client, f"{name}.Acked") is False


async def test_a_restart_shows_what_the_state_holds_as_bad_until_something_comes(known):
    wire = Wire(known)
    for _ in range(4):
        wire.learn(GROUPS[0], 60)
    kept = Group(known.groups[GROUPS[0]], 1)
    kept.remember(wire.stores[GROUPS[0]].get_bytes(MEMORY))
    wire.read()
    async with served(known, wire, blocks=list(kept.everything())) as (_, client):
        assert await value(client, "V0.RLS.SampleCount") == 240
        assert await code(client, "V0.RLS.PredictedFlow") & 0xC000_0000 == BAD
        wire.learn(GROUPS[0], 60)

        async def good():
            return await code(client, "V0.RLS.PredictedFlow") & 0xC000_0000 == GOOD

        await until(good)
        assert len(await value(client, "V0.Inverse.Map")) > 0  # from the state: none came since


def test_a_mirror_keeps_tables_surveys_and_the_rows_of_each_valve(known):
    wire = Wire(known)
    for _ in range(3):
        wire.learn(GROUPS[0])
    first, *_, last = wire.read().results
    mirror = Mirror(["V2", "V1"])  # another order, and one of them is not of this site
    shown = mirror.take(first)
    assert shown.valves.tolist() == [1, 0]
    assert all(table.size for table in shown.inverse.map_U)
    shown = mirror.take(last)
    assert last.results.estimators["RLS"].survey[1] is None
    assert shown.estimators["RLS"].survey[0] is not None
    assert shown.inverse.map_U[0].size
    (bad,) = mirror.again([0], int(Quality.BAD))
    assert bad.valves.tolist() == [0]
    assert bad.estimators["RLS"].quality.tolist() == [int(Quality.BAD)]
    np.testing.assert_array_equal(bad.signals.values, shown.signals.values[1:])
    assert list(Mirror(["W"]).again([0], 0)) == []
