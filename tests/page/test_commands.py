"""What a user may do is asked of the service, of the nodes that the command writes or calls."""

import pytest

from support.shown_service import ShownService
from valvemap.errors import CommandRejected, SourceLost
from valvemap.page.commands import carry_out, may_carry_out
from valvemap.page.log_ins import LogIn

COMMANDS = {
    "flow": (
        {"demand": "V1", "Q": 20, "dp": 90},
        ["V1.Inverse.PressureDrop", "V1.Inverse.FlowDemand"],
    ),
    "speed": ({"demand": "Press", "v": None}, ["Press.Inverse.SpeedDemand"]),
    "alarm": (
        {"alarm": "Changed", "of": "V1", "do": "Acknowledge", "comment": ""},
        ["V1.Alarms.Changed.Acknowledge"],
    ),
    "comment": (
        {"alarm": "Changed", "of": "V1", "do": "Comment", "comment": "seen", "event": "01"},
        ["V1.Alarms.Changed.Acknowledge"],
    ),
    "map": ({"baseline": "V1", "do": "RollBack"}, ["V1.Baseline.RollBack"]),
    "run": ({"run": "V1", "do": "Start", "accuracy": 1}, ["V1.Commission.Start"]),
    "heartbeat": ({"run": "V1", "do": "Heartbeat", "count": 1}, ["V1.Commission.Heartbeat"]),
    "scenario": ({"scenario": "cycle"}, ["Rig.StartScenario"]),
    "stop": ({"scenario": ""}, ["Rig.StopScenario"]),
    "fault": (
        {"fault": "damage", "valve": "V1", "size": 1, "duration": 0},
        ["V1.InjectFault"],
    ),
}


class Asked(ShownService):
    """Keeps of which nodes rights were asked, and may lose its session."""

    is_lost = False
    connections = 0
    nodes = ()

    async def connect(self):
        self.is_lost = False
        self.connections += 1

    async def permitted(self, ids):
        if self.is_lost:
            raise SourceLost("gone")
        self.nodes = ids
        return [self.may_write for _ in ids]


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
async def test_rights_are_those_of_the_nodes_that_the_command_uses(command):
    asked, nodes = command
    service = Asked()
    log_in = LogIn("operator", service, service, 0.0)
    assert await may_carry_out(log_in, asked)
    assert service.nodes == nodes
    assert service.writes == service.calls == service.comments == []
    await carry_out(log_in, asked)
    used = [id_ for id_, _ in service.writes]
    used += [f"{owner}.{method}" for owner, method, _ in service.calls]
    assert used == nodes or len(service.comments) == 1
    service.may_write = False
    assert not await may_carry_out(log_in, asked)


async def test_a_log_in_outlives_an_outage_of_the_service():
    service, rig = Asked(), Asked()
    log_in = LogIn("operator", service, rig, 0.0)
    service.is_lost = True
    assert await may_carry_out(log_in, COMMANDS["flow"][0])
    assert (service.connections, rig.connections, log_in.connections) == (1, 1, 1)
    await log_in.reconnect(0)  # of another question that was lost before
    assert service.connections == 1


async def test_what_is_no_command_is_no_right_either():
    log_in = LogIn("operator", Asked(), None, 0.0)
    for wrong in ({}, {"demand": "V1"}, {"alarm": "A", "of": "V1", "comment": ""}, {"scenario": 1}):
        with pytest.raises(CommandRejected):
            await may_carry_out(log_in, wrong)
    with pytest.raises(CommandRejected, match="no virtual rig"):
        await may_carry_out(log_in, {"scenario": "cycle"})
