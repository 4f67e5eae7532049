"""The nodes of an axis: findings as those of valves, and a new reference."""

import asyncio
import dataclasses
from contextlib import asynccontextmanager
from datetime import UTC, datetime

import numpy as np
from asyncua import ua

from guarded_opcua import Role, UserStore
from support.clocks import TurnedClock
from support.results import results_settings
from support.served import PASSWORD, patient
from support.users import CHEAP
from valvemap.errors import CommandRejected
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.axis_alarms import AxisAlarms
from valvemap.pipeline.axis_ports import AxisMap, AxisResults, RequiredU
from valvemap.pipeline.axis_tracking import AxisTracking
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.past_pieces import pieces_of
from valvemap.storage.history import HistoryFile
from valvemap.vocabulary.axis_quantities import AXIS_QUANTITIES
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.health import DeviceHealth
from valvemap.vocabulary.statuses import AxisStatus

T = 1_800_000_000_000_000_000
LEAK = Finding(FindingCode.LEAKAGE_CHANGE, 0.93, "Between the lines 0.004 (l/min)/bar leak more.")
EDGE = Finding(FindingCode.PA_CHANGE, 0.07, "The edge PA passes 3 % less than before.")


class Operator:
    def __init__(self):
        self.calls = []
        self.of_axis = AxisAlarms()

    def alarms(self, valve):
        return ()

    def alarmed(self):
        return ()

    def alarms_of(self, axis):
        return self.of_axis.reports()

    def act_on_alarm(self, command):
        self.of_axis.act(command)

    def set_reference(self, axis):
        if self.calls:
            raise CommandRejected("not now")
        self.calls.append(axis)

    def arm_axis(self, axis, *, armed):
        self.calls.append((axis, armed))

    def demand_speed(self, axis, v):
        self.calls.append((axis, v))

    def invert_speed(self, *asked):
        self.calls.append(asked)
        return RequiredU()


def results(findings):
    return AxisResults(AxisStatus.OK, "", T, 100.0, {}, None, RequiredU(), findings)


def operators():
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, PASSWORD)
    return dataclasses.replace(results_settings(none_on_loopback=True), users=users)


@asynccontextmanager
async def as_operator(server):
    client = patient(server.url)
    client.set_user("operator")
    client.set_password(PASSWORD)
    async with client:
        yield client


async def test_findings_are_shown_as_those_of_valves_and_a_reference_is_set():
    operator = Operator()
    async with ResultsServer(operators(), [], operator, TurnedClock(T)) as server:
        await server.follow_axes(["Press"], operator)
        async with as_operator(server) as client:
            index = await client.get_namespace_index(NAMESPACE)

            def node(name):
                return client.get_node(ua.NodeId(f"Press.{name}", index))

            async def read(name):
                return await node(f"Diagnostics.{name}").read_data_value(raise_on_bad_status=False)

            server.show_axis("Press", results(None))
            assert (await read("Findings")).Value.Value == []
            assert (await read("Findings")).StatusCode.name == "UncertainInitialValue"
            server.show_axis("Press", results((LEAK, EDGE)))
            found = await read("Findings")
            assert found.StatusCode.is_good()
            assert found.Value.Value == [LEAK.sentence, EDGE.sentence]
            assert (await read("FindingCodes")).Value.Value == [22, 18]
            assert (await read("FindingProbabilities")).Value.Value == [0.93, 0.07]
            course = AxisTracking(T + np.arange(3), np.array([1.0, 2, 3]), np.zeros(3), 2.2)
            server.show_axis("Press", dataclasses.replace(results(()), tracking=course))
            assert await node("Tracking.Rms").read_value() == 2.2
            assert await node("Tracking.Position").read_value() == [1.0, 2.0, 3.0]
            assert await node("Tracking.Time").read_value() == [T / 1e9] * 3
            server.show_axis("Press", results(()))
            assert (await read("FindingCodes")).Value.Value == []
            method = ua.NodeId("Press.Diagnostics.SetReference", index)
            await node("Diagnostics").call_method(method)
            for name in ("Arm", "Disarm"):
                await node("Inverse").call_method(ua.NodeId(f"Press.Inverse.{name}", index))
            armed = dataclasses.replace(
                results(()), is_armed=True, feed_forward=FeedForwardStatus.WRITING
            )
            server.show_axis("Press", armed)
            assert await node("Inverse.Armed").read_value() is True
            writing = await node("Inverse.FeedForwardStatus").read_value()
            assert writing == FeedForwardStatus.WRITING
            invert = ua.NodeId("Press.Inverse.Invert", index)
            await node("Inverse").call_method(invert, 100.0, 50.0, np.nan, np.nan, np.nan, 60.0)
    assert operator.calls[0] == "Press"
    assert operator.calls[1:3] == [("Press", True), ("Press", False)]
    axis, *asked = operator.calls[3]
    assert axis == "Press"
    assert np.array_equal(asked, [100.0, 50.0, np.nan, np.nan, np.nan, 60.0], equal_nan=True)


async def test_alarms_are_tags_and_conditions_that_an_operator_acknowledges(tmp_path):
    operator, changes = Operator(), []
    async with ResultsServer(
        operators(), [], operator, TurnedClock(T), on_alarm=changes.append
    ) as server:
        await server.follow_axes(["Press"], operator)
        async with as_operator(server) as client:
            index = await client.get_namespace_index(NAMESPACE)

            def node(name):
                return client.get_node(ua.NodeId(f"Press.Alarms.LeakageChanged.{name}", index))

            def show(*findings):
                found = results(findings)
                operator.of_axis.judge(found, T, 0.0)
                server.show_axis("Press", dataclasses.replace(found, alarms=operator.alarms_of("")))

            health = client.get_node(ua.NodeId("Press.DeviceHealth", index))
            unknown = await health.read_data_value(raise_on_bad_status=False)
            assert unknown.StatusCode.name == "BadWaitingForInitialData"
            show()
            assert await node("Active").read_value() is False
            assert await health.read_value() == DeviceHealth.NORMAL
            show(LEAK)
            assert await node("Active").read_value() is True
            assert await health.read_value() == DeviceHealth.MAINTENANCE_REQUIRED
            folder = client.get_node(ua.NodeId("Press", index))
            interfaces = await folder.get_referenced_nodes(ua.ObjectIds.HasInterface)
            assert [(await one.read_browse_name()).Name for one in interfaces] == [
                "IDeviceHealthType"
            ]
            assert (await node("Text").read_value()).startswith(LEAK.sentence)
            (child,) = [
                one
                for one in await client.get_node(
                    ua.NodeId("Press.Alarms.LeakageChanged", index)
                ).get_children()
                if one.nodeid.Identifier.endswith("Acknowledge")
            ]
            alarm = client.get_node(ua.NodeId("Press.Alarms.LeakageChanged", index))
            await alarm.call_method(child.nodeid, "seal renewed")
            assert await node("Acked").read_value() is True
            show()
            assert await node("Active").read_value() is False
            assert await health.read_value() == DeviceHealth.NORMAL
        await server.follow_axes([], None)
        await server.follow_axes(["Press"], operator)
    kept = [(one.owner, one.report.name, one.report.active, one.report.acked) for one in changes]
    assert kept == [
        ("Press", "LeakageChanged", True, False),
        ("Press", "LeakageChanged", True, True),
        ("Press", "LeakageChanged", False, True),
    ]


MAP = AxisMap(
    *((0.9, 0.01), (0.002, 0.0001), (0.1, 0.02)), 2.0, 40.0, *(np.zeros((4, 1)) for _ in range(3)),
    known=np.zeros(4),
)  # fmt: skip


async def test_the_past_of_an_axis_is_read_from_the_history(tmp_path):
    operator = Operator()
    with HistoryFile(tmp_path / "history.sqlite") as store:
        keeper = PastKeeper(store, [])
        for k in range(3):
            required = RequiredU(20.0 + k)
            moved = dataclasses.replace(MAP, leakage=(0.002 + 0.001 * k, 0.0001))
            found = dataclasses.replace(results(()), t=T + k, map=moved, required=required)
            keeper.note_axis(pieces_of("Press", found, with_map=k != 1))
        stale = dataclasses.replace(found, is_stale=True, required=RequiredU(), t=T + 3)
        keeper.note_axis(pieces_of("Press", stale, with_map=True))
        failed = dataclasses.replace(stale, status=AxisStatus.FAILED, t=T + 5)
        keeper.note_axis(pieces_of("Press", failed, with_map=False))
        assert await keeper.settle()
        async with ResultsServer(operators(), [], operator, TurnedClock(T), past=store) as server:
            await server.follow_axes(["Press"], operator)
            async with patient(server.url) as client:
                index = await client.get_namespace_index(NAMESPACE)

                async def past(name):
                    node = client.get_node(ua.NodeId(f"Press.{name}", index))
                    moment = datetime.fromtimestamp(T / 1e9, UTC).replace(tzinfo=None)
                    return await node.read_raw_history(moment, None, 10)

                leakage, answers = await asyncio.gather(past("Leakage"), past("Inverse.RequiredU"))
                assert [one.Value.Value for one in leakage] == [0.002, 0.004, 0.004]
                assert leakage[-1].StatusCode.name.startswith("Uncertain")
                assert [one.Value.Value for one in answers] == [20.0, 21.0, 22.0]
                for quantity in AXIS_QUANTITIES:
                    assert len(await past(quantity.name)) == 3, quantity.name
                stood = await past("Status")
                assert [one.Value.Value for one in stood] == [0, 0, 0, 0, AxisStatus.FAILED]
                assert all(one.StatusCode.is_good() for one in stood)
