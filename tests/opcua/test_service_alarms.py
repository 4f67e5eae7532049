"""Each row of the table of the service's alarms is published: as tags, and as a condition."""

import numpy as np
import pytest
from asyncua import ua

from support.conditions import Listener, raised
from support.plant import START
from valvemap.pipeline.result_ports import Health
from valvemap.pipeline.service_alarms import FLEET_RULES, ServiceAlarms
from valvemap.vocabulary.service_alarms import OF_FLEET, ServiceAlarm

ABOVE = 1e6  # every limit
pytestmark = pytest.mark.asyncio(loop_scope="module")


async def show(plant):
    alarms = plant.live.alarms(None)
    health = Health(np.zeros(1), np.zeros(1, np.int64), alarms=alarms)
    await plant.server.show_health(health)


async def test_each_alarm_of_the_table_has_tags_and_a_condition_and_is_acknowledged():
    async with raised() as plant, Listener.of(plant) as listener:
        alarms = plant.live._parts.alarms.of_service = ServiceAlarms(FLEET_RULES)
        index = await listener.namespace()
        await show(plant)
        for alarm in OF_FLEET:
            at = START
            alarms.give_reason(alarm, "the reason")
            for _ in range(2):  # the load has a delay
                at += 60_000_000_000
                alarms.note(at, {alarm: ABOVE})
            await show(plant)
            (came,) = await listener.next()
            assert came.state == (alarm.label, True, False, True, True)
            assert came.condition == ua.NodeId(f"Service.Alarms.{alarm.label}.Condition", index)

            async def tag(name, alarm=alarm):
                node = ua.NodeId(f"Service.Alarms.{alarm.label}.{name}", index)
                return await listener.client.get_node(node).read_value()

            assert await tag("Active") is True
            assert await tag("Text") == came["Message"].Text
            assert await tag("Severity") == came["Severity"]
            assert await listener.act("Acknowledge", came, "seen") == ua.StatusCodes.Good
            (seen,) = await listener.next()
            assert seen.state == (alarm.label, True, True, False, True)
            assert await tag("Acked") is True
            if alarm is ServiceAlarm.MESSAGES_REJECTED:
                assert "(the reason)" in came["Message"].Text
