"""A client cannot tell whether its items are served one by one or as arrays: byte for byte."""

import math
import random

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import (
    HardenedServer,
    Limits,
    ServerSettings,
    add_object,
    add_variable,
)
from guarded_opcua.binary.encoding import encode_data_value, encode_publish_response
from guarded_opcua.clock import ManualClock
from guarded_opcua.errors import ServerError
from guarded_opcua.monitoring import block_items
from guarded_opcua.monitoring.block_items import BlockItem
from guarded_opcua.security.accounts import Role
from guarded_opcua.sessions.session import Session
from guarded_opcua.subscriptions.pace import Pace
from guarded_opcua.subscriptions.publish_queue import PublishRequest

pytestmark = pytest.mark.asyncio(loop_scope="module")

N = 5
START = 1_700_000_000_000_000_000
DOUBLE, UINT32 = ua.VariantType.Double, ua.VariantType.UInt32
Mode = ua.MonitoringMode
CODES = (0, 0, 0, 0x40900000, 0x80000000, 0x808C0000)
VALUES = (0.0, -0.0, 1.0, 1.25, 3.0, math.nan, math.inf, -7.5)
BLOCKS = {"a": (DOUBLE, None), "b": (UINT32, None), "c": (DOUBLE, 3)}


class Line:
    """Stands for a connection; keeps every response as it would be sent."""

    host, peer_certificate, writable = "test", None, True

    def __init__(self):
        self.sent = []

    def charge(self, cost):
        pass

    def answer_publish(self, request, number, message):
        self.sent.append(
            encode_publish_response(
                request.handle,
                0,
                number,
                message.available,
                message.more,
                message.content,
                request.results,
            )
        )

    def refuse(self, request_id, handle, code):
        self.sent.append((request_id, handle, code))


async def no_breath():
    pass


def at_once(coroutine):
    """Run a coroutine that never waits."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


class Side:
    """One server with its clients: with blocks, or without."""

    def __init__(self, server, variables, blocks):
        self.server, self.variables, self.blocks = server, variables, blocks
        self.clock = server._clock
        self.handles = 0

    def restart(self, limits, sessions):
        """Begin anew: new subscriptions, the same nodes."""
        service = self.server._subscriptions
        for subscription in list(service.by_number.values()):
            service.end(subscription)
        service.chores.finish()
        service._limits = limits
        service.created = 0
        ledger = service.ledger
        ledger.capacity, ledger.lost, ledger.queued = limits.queued_notifications, 0, 0
        service._item_numbers = iter(range(1, 10**6))
        self.lines = [Line() for _ in range(sessions)]
        self.sessions = [
            Session(line, "test", 1e9, limits, self.clock, service.ledger, Pace(self.clock))
            for line in self.lines
        ]
        for name, (_, length) in BLOCKS.items():
            zero = np.zeros((1, N) if length is None else (1, N, length))
            self.write(name, zero, [START], 0, None)

    def write(self, name, values, times, codes, present):
        if self.blocks:
            self.server.write_block(self.blocks[name], values, times, codes, present)
            return
        k = len(values)
        codes = np.broadcast_to(codes, (k, N))
        times = np.broadcast_to(np.reshape(times, (k, -1)), (k, N))
        self.server.write(
            (self.variables[name][i], values[j, i], int(codes[j, i]), int(times[j, i]))
            for j in range(k)
            for i in range(N)
            if present is None or present[j, i]
        )

    def mark(self, name, code):
        if self.blocks:
            self.server.mark_block(self.blocks[name], code)
        else:
            for variable in self.variables[name]:
                self.server.mark(variable, code)

    def publish(self, who, acks):
        session = self.sessions[who]
        self.handles += 1
        results = self.server._subscriptions.acknowledge(session, acks)
        session.add_publish_request(PublishRequest(self.handles, self.handles, results, math.inf))
        return results

    def read(self, name, column):
        wanted = ua.ReadValueId(self.variables[name][column].id, ua.AttributeIds.Value)
        return encode_data_value(self.server._attributes.read(wanted, Role.OBSERVER), 2)


async def make(clock, *, with_blocks):
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/",
        application_uri="urn:test:blocks",
        application_name="blocks",
        namespace_uri="urn:test",
        none_on_loopback=True,
    )
    server = await HardenedServer.create(settings, clock)
    root = await add_object(server, None, "Root")
    variables, blocks = {}, {}
    for name, (kind, length) in BLOCKS.items():
        variables[name] = [
            await add_variable(
                server,
                root,
                f"{name}{i}",
                None,
                type=kind,
                dimensions=None if length is None else (length,),
            )
            for i in range(N)
        ]
        if with_blocks:
            blocks[name] = server.add_block(variables[name], length)
    return Side(server, variables, blocks)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def sides():
    clock = ManualClock(START)
    return [await make(clock, with_blocks=True), await make(clock, with_blocks=False)], clock


def monitoring(rng, *, plain):
    filter_ = None
    if rng.random() < 0.4:
        kinds = (ua.DeadbandType.None_, *([] if plain else [ua.DeadbandType.Absolute]))
        kind = rng.choice(kinds)
        filter_ = ua.DataChangeFilter(
            Trigger=rng.choice(list(ua.DataChangeTrigger)), DeadbandType=kind, DeadbandValue=1.0
        )
    return ua.MonitoringParameters(
        ClientHandle=rng.randrange(2**32),
        SamplingInterval=0.0 if plain or rng.random() < 0.8 else 120.0,
        Filter=filter_,
        QueueSize=rng.choice((0, 1, 2, 3, 10, 100)),
        DiscardOldest=plain or rng.random() < 0.6,
    )


def samples(rng, length):
    k = rng.choice((1, 1, 2, 5, 9))
    shape = (k, N) if length is None else (k, N, length)
    few = VALUES if length is not None or rng.random() < 0.7 else VALUES[:2]
    values = np.array([rng.choice(few) for _ in range(math.prod(shape))]).reshape(shape)
    times = START + np.array([rng.randrange(10**9) for _ in range(k)])
    if rng.random() < 0.3:
        times = times[:, None] + np.array([rng.randrange(1000) for _ in range(N)])
    codes = 0
    if rng.random() < 0.4:
        codes = np.array([rng.choice(CODES) for _ in range(k * N)]).reshape(k, N)
    present = None
    if rng.random() < 0.3:
        present = np.array([rng.random() < 0.7 for _ in range(k * N)]).reshape(k, N)
    return values, times, codes, present


def whole(values):
    return np.abs(np.nan_to_num(values, posinf=9.0)).astype(np.uint32)


class Play:
    """Does the same to both sides, and compares all that they answer."""

    def __init__(self, sides, clock, seed, *, limits, sessions, plain):
        self.rng = random.Random(seed)
        self.sides, self.clock, self.plain = sides, clock, plain
        self.other = Mode.Reporting if plain else Mode.Sampling
        for side in sides:
            side.restart(limits, sessions)
        self.subscriptions = []  # (session, number)
        self.items = {}
        self.who = sessions
        self.unacknowledged = []

    def both(self, do):
        first, second = (do(side) for side in self.sides)
        assert first == second
        return first

    def subscribe(self):
        if len(self.subscriptions) >= 2 * self.who or (self.plain and self.subscriptions):
            return
        who = self.rng.randrange(self.who)
        params = ua.CreateSubscriptionParameters(
            RequestedPublishingInterval=50.0,
            RequestedLifetimeCount=10_000,
            RequestedMaxKeepAliveCount=self.rng.choice((3, 30)),
            MaxNotificationsPerPublish=self.rng.choice((0, 1, 7, 30)),
            PublishingEnabled=True,
        )
        result = self.both(lambda s: s.server._subscriptions.create(s.sessions[who], params))
        self.subscriptions.append((who, result.SubscriptionId))
        self.items[result.SubscriptionId] = []

    def some(self):
        who, number = self.rng.choice(self.subscriptions)
        return who, number, self.items[number]

    def watch(self):
        who, number, items = self.some()
        name, column = self.rng.choice(list(BLOCKS)), self.rng.randrange(N)
        asked = monitoring(self.rng, plain=self.plain)
        mode = self.rng.choice((Mode.Reporting, Mode.Reporting, self.other, Mode.Disabled))
        stamps = ua.TimestampsToReturn(self.rng.randrange(4))

        def do(side):
            request = ua.MonitoredItemCreateRequest(
                ua.ReadValueId(side.variables[name][column].id, ua.AttributeIds.Value), mode, asked
            )
            return side.server._subscriptions.items.create(
                side.sessions[who], number, request, stamps
            )

        result = self.both(do)
        if result.StatusCode.is_good():
            items.append(result.MonitoredItemId)

    def modify(self):
        who, number, items = self.some()
        if not items:
            return
        asked = monitoring(self.rng, plain=self.plain)
        request = ua.MonitoredItemModifyRequest(self.rng.choice(items), asked)
        stamps = ua.TimestampsToReturn(self.rng.randrange(4))
        self.both(
            lambda s: s.server._subscriptions.items.modify(s.sessions[who], number, request, stamps)
        )

    def set_mode(self):
        who, number, items = self.some()
        mode = self.rng.choice((Mode.Disabled, Mode.Reporting, self.other))
        for item in self.rng.sample(items, min(2, len(items))):
            self.both(
                lambda s, item=item: s.server._subscriptions.items.set_monitoring(
                    s.sessions[who], number, item, mode
                )
            )

    def link(self):
        who, number, items = self.some()
        if len(items) < 2 or self.plain:
            return
        a, b = self.rng.sample(items, 2)
        self.both(lambda s: s.server._subscriptions.items.link(s.sessions[who], number, a, b))

    def delete(self):
        who, number, items = self.some()
        if not items:
            return
        gone = self.rng.choice(items)
        items.remove(gone)
        self.both(lambda s: s.server._subscriptions.items.delete(s.sessions[who], number, gone))

    def switch(self):
        who, number, _ = self.some()
        on = self.rng.random() < 0.7
        self.both(
            lambda s: s.server._subscriptions.set_publishing(s.sessions[who], number, enabled=on)
        )

    def resend(self):
        who, number, _ = self.some()
        self.both(
            lambda s: at_once(
                s.server._subscriptions.items.resend(s.sessions[who], number, no_breath)
            )
        )

    def write(self):
        name = self.rng.choice(list(BLOCKS))
        values, times, codes, present = samples(self.rng, BLOCKS[name][1])
        if BLOCKS[name][0] == UINT32:
            values = whole(values)
        self.both(lambda s: s.write(name, values, times, codes, present))

    def write_one(self):
        name, column = self.rng.choice("ab"), self.rng.randrange(N)
        value, code = self.rng.choice((0.0, 1.0, 3.0)), self.rng.choice(CODES)
        at = self.clock.now()
        self.both(lambda s: s.server.write([(s.variables[name][column], value, code, at)]))

    def mark(self):
        name, code = self.rng.choice(list(BLOCKS)), self.rng.choice(CODES)
        self.both(lambda s: s.mark(name, code))

    def publish(self):
        who = self.rng.randrange(self.who)
        acks = []
        if self.subscriptions and self.rng.random() < 0.5:
            acks = [
                ua.SubscriptionAcknowledgement(
                    self.rng.choice(self.subscriptions)[1], self.rng.randrange(1, 20)
                )
            ]
        self.both(lambda s: s.publish(who, acks))

    def read(self):
        name, column = self.rng.choice(list(BLOCKS)), self.rng.randrange(N)
        self.both(lambda s: s.read(name, column))

    def republish(self):
        who, number, _ = self.some()
        sequence = self.rng.randrange(1, 20)

        def do(side):
            try:
                params = ua.RepublishParameters(number, sequence)
                return side.server._subscriptions.republish(side.sessions[who], params)
            except Exception as error:  # noqa: BLE001 - part of what is compared
                return getattr(error, "code", None)

        self.both(do)

    def wait(self):
        seconds = self.rng.choice((0.01, 0.05, 0.2))
        self.clock.advance(seconds)

    def step(self):
        weights = {
            self.write: 10,
            self.write_one: 2,
            self.mark: 0.3,
            self.publish: 5,
            self.wait: 5,
            self.watch: 3,
            self.modify: 1.5,
            self.set_mode: 1.5,
            self.link: 0.3,
            self.delete: 0.7,
            self.subscribe: 0.3,
            self.switch: 0.3,
            self.resend: 0.3,
            self.read: 2,
            self.republish: 0.5,
        }
        self.rng.choices(list(weights), list(weights.values()))[0]()
        self.both(lambda s: [line.sent for line in s.lines])
        self.both(
            lambda s: (s.server.counters.queued_notifications, s.server.counters.monitored_items)
        )
        self.both(lambda s: s.server.counters.lost_notifications)


def play(sides, clock, monkeypatch, seed, steps, **options):
    monkeypatch.setattr(block_items, "_FEWEST", 1)
    game = Play(sides, clock, seed, **options)
    for _ in range(3):
        game.subscribe()
    for _ in range(15):
        game.watch()
    for _ in range(steps):
        game.step()
    return game


@pytest.mark.parametrize("seed", range(10))
async def test_every_response_is_the_same_whatever_clients_and_server_do(sides, monkeypatch, seed):
    both, clock = sides
    game = play(both, clock, monkeypatch, seed, 250, limits=Limits(), sessions=2, plain=False)
    sent = [response for line in both[0].lines for response in line.sent]
    assert sum(isinstance(response, bytes) and len(response) > 80 for response in sent) > 5
    assert any(
        isinstance(item, BlockItem)
        for s in both[0].server._subscriptions.by_number.values()
        for item in s.items.values()
    )
    assert game.subscriptions


@pytest.mark.soak
async def test_every_response_is_the_same_in_a_thousand_plays(sides, monkeypatch):
    both, clock = sides
    for seed in range(100, 600):
        play(both, clock, monkeypatch, seed, 250, limits=Limits(), sessions=2, plain=False)
        limits = Limits(queued_notifications=5 + seed % 40)
        play(both, clock, monkeypatch, seed, 250, limits=limits, sessions=1, plain=True)


@pytest.mark.parametrize("seed", range(6))
async def test_where_there_is_no_room_for_more_the_same_are_lost(sides, monkeypatch, seed):
    both, clock = sides
    limits = Limits(queued_notifications=20 + seed % 20 % 20)
    play(both, clock, monkeypatch, seed, 250, limits=limits, sessions=1, plain=True)
    assert both[0].server.counters.lost_notifications > 0


async def test_a_block_is_of_numbers_of_one_type_and_one_shape(sides):
    side = sides[0][1]
    mixed = [side.variables["a"][0], side.variables["b"][0]]
    for variables, length, reason in (
        (mixed, None, "b0: a block is of numbers of one type"),
        (side.variables["a"], 3, "a0: a block is of scalars, or of arrays"),
        ([], None, "a block needs variables"),
    ):
        with pytest.raises(ServerError, match=reason):
            side.server.add_block(variables, length)


async def test_samples_of_another_shape_are_refused(sides):
    side = sides[0][0]
    with pytest.raises(ValueError, match=r"shape \(1, 3\), allowed is \(-1, 5\)"):
        side.server.write_block(side.blocks["a"], np.zeros((1, 3)), [START])


async def test_an_array_that_was_written_can_be_used_again(sides, monkeypatch):
    both, clock = sides
    game = play(both, clock, monkeypatch, 1, 0, limits=Limits(), sessions=1, plain=True)
    values = np.ones((2, N))
    game.both(lambda s: s.write("a", values, [START, START + 100], 0, None))
    values[:] = 5.0
    game.publish()
    game.wait()
    game.both(lambda s: [line.sent for line in s.lines])
