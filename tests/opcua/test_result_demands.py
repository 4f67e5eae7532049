"""What stands at the inverse maps, while one operator follows another."""

import asyncio
from math import isnan

import pytest

from guarded_opcua import CommandRejected as Refused
from valvemap.errors import CommandRejected
from valvemap.opcua_results.result_demands import ResultDemands


class Operator:
    """Notes what is demanded, and rejects what is said so."""

    def do(self, command):
        return getattr(self, command.action)(*command.arguments)

    def __init__(self, rejects=()):
        self.demands, self.rejects = [], rejects

    def demand(self, valve, Q, dp):
        if valve in self.rejects:
            raise CommandRejected("not now")
        self.demands.append((valve, Q, dp))


class Slow(Operator):
    """Answers when it is let."""

    def __init__(self):
        super().__init__()
        self.let = asyncio.Event()

    async def demand(self, valve, Q, dp):
        await self.let.wait()
        super().demand(valve, Q, dp)


class Notes:
    def __init__(self):
        self.notes = []

    def acted(self, valve, action):
        self.notes.append((valve, action))


async def test_flow_and_pressure_drop_are_demanded_together():
    operator, notes = Operator(), Notes()
    demands = ResultDemands(operator, notes, ["Boom"])
    demands.flow("Boom", 50.0)
    demands.pressure_drop("Boom", 20.0)
    (first, second) = operator.demands
    assert first[:2] == ("Boom", 50.0)
    assert isnan(first[2])
    assert second == ("Boom", 50.0, 20.0)
    assert notes.notes[-1] == ("Boom", "Inverse demand 50 l/min at 20 bar")


async def test_what_is_rejected_does_not_stand():
    operator = Operator(rejects={"Boom"})
    demands = ResultDemands(operator, Notes(), ["Boom"])
    with pytest.raises(Refused, match="not now"):
        demands.flow("Boom", 50.0)
    operator.rejects = ()
    await demands.repeat()
    assert operator.demands == []


async def test_what_stands_is_repeated_but_for_valves_that_went():
    operator = Operator()
    demands = ResultDemands(operator, Notes(), ["Boom", "Stick"])
    for valve in ("Boom", "Stick"):
        demands.flow(valve, 50.0)
    operator.demands.clear()
    demands.follow(["Stick", "Bucket"], gone={"Boom"})
    await demands.repeat()
    ((valve, Q, _),) = operator.demands
    assert (valve, Q) == ("Stick", 50.0)


async def test_a_valve_that_was_made_anew_has_no_demand():
    operator = Operator()
    demands = ResultDemands(operator, Notes(), ["Boom"])
    demands.flow("Boom", 50.0)
    operator.demands.clear()
    demands.follow(["Boom"], gone={"Boom"})
    await demands.repeat()
    assert operator.demands == []


async def test_a_demand_that_another_operator_rejects_keeps_no_other_back():
    operator = Operator()
    demands = ResultDemands(operator, Notes(), ["Boom", "Stick"])
    for valve in ("Boom", "Stick"):
        demands.flow(valve, 50.0)
    operator.demands.clear()
    operator.rejects = {"Boom"}
    await demands.repeat()
    assert [valve for valve, _, _ in operator.demands] == ["Stick"]


async def test_an_answer_that_comes_when_its_valve_has_gone_leaves_nothing():
    operator = Slow()
    demands = ResultDemands(operator, Notes(), ["Boom"])
    answer = asyncio.ensure_future(demands.flow("Boom", 50.0))
    await asyncio.sleep(0)
    demands.follow([], gone={"Boom"})
    operator.let.set()
    await answer
    operator.demands.clear()
    await demands.repeat()
    assert operator.demands == []
