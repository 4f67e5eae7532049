"""The demo hears from the rig's process what has become of its valves."""

import asyncio

import pytest
from asyncua import ua

from support.processes import free_port, rig_url
from support.served import patient
from valvemap.cli.rig_conditions import conditions_in
from valvemap.cli.under_demo import rig_process

NAMESPACE = "urn:valvemap:rig"
VALVE = "Valvistor"


class Heard:
    """The newest condition of the valve, and when it was last another."""

    def __init__(self):
        self.worn, self.changed = None, asyncio.Event()

    def __call__(self, line):
        self.worn = conditions_in(line).get(VALVE, self.worn)
        self.changed.set()

    async def until(self, wanted):
        async with asyncio.timeout(20.0):
            while self.worn is None or not wanted(self.worn):
                self.changed.clear()
                await self.changed.wait()


@pytest.mark.waits
async def test_a_fault_that_an_operator_injects_is_in_the_truth_and_gone_with_the_scenario():
    heard = Heard()
    async with rig_process(rig_url(free_port()), "demo", "correct horse", heard) as where:
        client = patient(where)
        client.set_user("operator")
        client.set_password("correct horse")
        async with client:
            index = await client.get_namespace_index(NAMESPACE)
            await heard.until(lambda worn: worn.edge_factor == 1.0)
            valve = client.get_node(ua.NodeId(VALVE, index))
            inject = ua.NodeId(f"{VALVE}.InjectFault", index)
            said = await valve.call_method(inject, "damage", 12.0, 0.0)
            assert said.startswith("the main edge passes 12 % more: ")
            await heard.until(lambda worn: worn.edge_factor == 1.12)
            rig = client.get_node(ua.NodeId("TestRig", index))
            await rig.call_method(ua.NodeId("Rig.StartScenario", index), "scattered")
            await heard.until(lambda worn: worn.edge_factor == 1.0)
