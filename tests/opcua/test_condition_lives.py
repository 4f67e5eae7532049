"""Lives of a condition against a model of Part 9: two clients act, the service restarts between."""

import asyncio
from contextlib import AsyncExitStack
from dataclasses import dataclass, field

import pytest
from asyncua import ua
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from guarded_opcua import Limits
from support.conditions import Listener, raised

Codes = ua.StatusCodes
FAST = Limits(publishing_interval_ms=10.0, handshake_seconds=300.0)  # a busy machine logs in late

who = st.sampled_from((0, 1))
which = st.integers(0, 3)  # the newest event that was heard, or an earlier one
steps = st.lists(
    st.one_of(
        st.just(("come",)),
        st.just(("go",)),
        st.tuples(st.sampled_from(("Acknowledge", "Confirm", "AddComment")), who, which),
        st.tuples(st.just("refresh"), who),
        st.just(("restart",)),
    ),
    min_size=4,
    max_size=14,
)


@dataclass
class Model:
    """The states of annex B.1, without branches."""

    active: bool = False
    acked: bool = True
    to_confirm: bool = False
    coming: int = 0
    comment: str = ""
    of_coming: dict = field(default_factory=dict)  # by EventId

    def come(self):
        if self.active:
            return False
        self.active, self.acked, self.to_confirm = True, False, False
        self.coming += 1
        return True

    def go(self):
        was, self.active = self.active, False
        return was

    def act(self, name, event_id, comment):
        """The status code that is due."""
        if self.of_coming[event_id] != self.coming:
            return Codes.BadEventIdUnknown
        if name == "Acknowledge":
            if self.acked:
                return Codes.BadConditionBranchAlreadyAcked
            self.acked = self.to_confirm = True
        if name == "Confirm":
            if not self.to_confirm:
                return Codes.BadConditionBranchAlreadyConfirmed
            self.to_confirm = False
        self.comment = comment
        return Codes.Good

    @property
    def state(self):
        retained = self.active or not self.acked or self.to_confirm
        return "LagFound", self.active, self.acked, not self.to_confirm, retained


class Stage:
    """A service and two clients that listen to it."""

    def __init__(self, plant):
        self.plant, self.listeners, self._clients = plant, [], AsyncExitStack()

    async def connect(self):
        await self._clients.aclose()
        self._clients = AsyncExitStack()
        connecting = (Listener.of(self.plant, interval=10.0) for _ in range(2))
        self.listeners = [await self._clients.enter_async_context(c) for c in connecting]

    async def restart(self):
        await self._clients.aclose()
        await self.plant.restart()
        await self.connect()

    async def close(self):
        await self._clients.aclose()

    async def heard(self, model):
        """Have both clients hear what the model says, once; the event."""
        (one,), (other,) = [await listener.next() for listener in self.listeners]
        assert one == other
        assert one.state == model.state
        assert (one["Comment"].Text or "") == model.comment
        assert one["EventId"] not in model.of_coming
        model.of_coming[one["EventId"]] = model.coming
        return one

    async def live(self, life):
        for listener in self.listeners:
            await listener.until_refreshed()  # what ended the life before was heard
        heard = []
        said = self.plant.report("LagFound").comment
        model = Model(coming=0, comment=said)
        for number, (name, *more) in enumerate(life):
            self.plant.clock.advance(1.0)
            await self.step(model, heard, number, name, more)
            report = self.plant.report("LagFound")
            assert (report.active, report.acked, not report.confirmed) == (
                model.active,
                model.acked,
                model.to_confirm,
            )
        for listener in self.listeners:
            assert await listener.refreshed() == ([heard[-1]] if model.state[-1] else [])

    async def step(self, model, heard, number, name, more):
        match name, *more:
            case ("come",):
                changes = model.come()
                await self.plant.set_lag(0.3)
            case ("go",):
                changes = model.go()
                await self.plant.set_lag(0.0)
            case ("restart",):
                changes = False
                await self.restart()
            case "refresh", who:
                changes = False
                shown = await self.listeners[who].refreshed()
                assert shown == ([heard[-1]] if model.state[-1] else [])
            case name, who, which:
                if not heard:
                    return
                event, comment = heard[max(0, len(heard) - 1 - which)], f"step {number}"
                due = model.act(name, event["EventId"], comment)
                assert await self.listeners[who].act(name, event, comment) == due
                changes = due == Codes.Good
        if changes:
            heard.append(await self.heard(model))


def play(examples):
    """Play lives, one after the other, on one stage."""
    with asyncio.Runner() as runner:

        async def raise_():
            plant = await stack.enter_async_context(raised(limits=FAST))
            stage = Stage(plant)
            await stage.connect()
            return stage

        stack = AsyncExitStack()
        stage = runner.run(raise_())

        async def calm_and_live(life):
            await stage.plant.calm()
            await stage.live(life)

        @settings(
            max_examples=examples,
            derandomize=True,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        @given(life=steps)
        def lives(life):
            runner.run(calm_and_live(life))

        try:
            lives()
        finally:
            runner.run(stage.close())
            runner.run(stack.aclose())


def test_lives_go_as_the_model_says():
    play(3)


@pytest.mark.soak
def test_many_lives_go_as_the_model_says():
    play(400)
