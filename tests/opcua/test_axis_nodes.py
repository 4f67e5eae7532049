"""The nodes of an axis: findings as those of valves, and a new reference."""

import dataclasses

import numpy as np
from asyncua import Client, ua

from guarded_opcua import Role, UserStore
from support.clocks import TurnedClock
from support.results import results_settings
from support.served import PASSWORD
from valvemap.errors import CommandRejected
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.axis_ports import AxisResults, RequiredU
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import AxisStatus, FeedForwardStatus

T = 1_800_000_000_000_000_000
LEAK = Finding(FindingCode.LEAKAGE_CHANGE, 0.93, "Between the lines 0.004 (l/min)/bar leak more.")
EDGE = Finding(FindingCode.PA_CHANGE, 0.07, "The edge PA passes 3 % less than before.")


class Operator:
    def __init__(self):
        self.calls = []

    def alarms(self, valve):
        return ()

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


async def test_findings_are_shown_as_those_of_valves_and_a_reference_is_set():
    operator = Operator()
    users = UserStore()
    users.add("operator", Role.OPERATOR, PASSWORD)
    settings = dataclasses.replace(results_settings(none_on_loopback=True), users=users)
    async with ResultsServer(settings, [], operator, TurnedClock(T)) as server:
        await server.follow_axes(["Press"], operator)
        client = Client(server.url)
        client.set_user("operator")
        client.set_password(PASSWORD)
        async with client:
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
