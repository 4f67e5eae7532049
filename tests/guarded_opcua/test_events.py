"""Events handed to who listens: each once, and a costly filter is its owner's cost alone."""

import pytest
from asyncua import ua

from guarded_opcua import ManualClock, Role
from guarded_opcua.chores import Chores
from guarded_opcua.monitoring.event_item import EventItem, Listening
from guarded_opcua.monitoring.events import Event
from guarded_opcua.subscriptions.events import EventDelivery

SERVER, PLANT = ua.NodeId(ua.ObjectIds.Server), ua.NodeId("Plant", 1)
OVERFLOW = ua.NodeId(ua.ObjectIds.EventQueueOverflowEventType)


class Worked(ManualClock):
    """Work takes the processor's time alone: what is due meanwhile runs when it is done."""

    def work(self, seconds):
        self._work += seconds


class Filter:
    """Passes every event, at a price."""

    def __init__(self, clock, cost):
        self._clock, self._cost = clock, cost
        self.judges = cost > 0.0

    def __len__(self):
        return 1

    def passes(self, _):
        self._clock.work(self._cost)
        return True

    def select(self, event):
        return event


class Holding:
    moment = 0

    def has_room(self):
        return True

    def add(self, count):
        pass

    def lose(self, count):
        pass


class Subscription:
    """A client's, with one item; it is its own owner."""

    def __init__(self, number, clock, *, cost=0.0, queue=1_000, node=SERVER, oldest=True):
        self.owner, self.holding, self.charged = self, Holding(), 0.0
        wanted = ua.ReadValueId(node, ua.AttributeIds.EventNotifier)
        listening = Listening(number, Filter(clock, cost), queue, discard_oldest=oldest)
        self.item = EventItem(self, number, wanted, ua.MonitoringMode.Reporting, listening)

    def hears(self, role):
        return role <= Role.OBSERVER

    def charge(self, cost):
        self.charged += cost

    def has_report(self, number):
        pass

    def has_no_report(self, number):
        pass

    def taken(self):
        return [event for _, event in self.item.take(10_000)]


def event(number, *emitters, audience=Role.OBSERVER):
    fields = {"Number": number, "Time": number}
    return Event(emitters or (SERVER,), ua.NodeId(2041), fields, audience)


@pytest.fixture
def clock():
    return Worked()


@pytest.fixture
def delivery(clock):
    return EventDelivery(Chores(clock), clock)


def watching(delivery, *subscriptions):
    for subscription in subscriptions:
        delivery.watch(subscription, subscription.item)
    return subscriptions


def test_who_listens_to_an_emitter_hears_of_it_and_nobody_else(delivery, clock):
    at_server, at_plant = watching(
        delivery, Subscription(1, clock), Subscription(2, clock, node=PLANT)
    )
    delivery.trigger(event(1, SERVER, PLANT))
    delivery.trigger(event(2))
    delivery.trigger(event(3, audience=Role.SECURITY_ADMIN))
    assert [e.fields["Number"] for e in at_server.taken()] == [1, 2]
    assert [e.fields["Number"] for e in at_plant.taken()] == [1]
    assert delivery.has_audience((PLANT,), Role.OBSERVER)
    delivery.forget(at_plant.item)
    assert not delivery.has_audience((PLANT,), Role.OBSERVER)
    assert len(delivery) == 1


def test_a_costly_filter_keeps_nobody_waiting_and_is_charged_to_its_owner(delivery, clock):
    plain, cheap, costly = watching(
        delivery,
        Subscription(1, clock),
        Subscription(2, clock, cost=1e-5),
        Subscription(3, clock, cost=0.015),  # the dearest that a filter can be
    )
    for number in range(200):
        delivery.trigger(event(number))
    assert len(plain.taken()) == 200  # at once
    heard, longest = 0, 0.0
    for _ in range(600):
        before = clock.processor()
        clock.advance(0.004)
        longest = max(longest, clock.processor() - before)
        heard += len(cheap.taken())
    assert heard == 200
    assert longest < 0.05
    assert costly.charged > 50 * cheap.charged


def test_what_finds_no_room_is_said_once_where_it_was(delivery, clock):
    newest, oldest = watching(
        delivery, Subscription(1, clock, queue=3), Subscription(2, clock, queue=3, oldest=False)
    )
    for number in range(9):
        delivery.trigger(event(number))
    kept, first = newest.taken(), oldest.taken()
    assert [e.kind == OVERFLOW for e in kept] == [True, False, False, False]
    assert [e.fields["Number"] for e in kept[1:]] == [6, 7, 8]
    assert [e.kind == OVERFLOW for e in first] == [False, False, False, True]
    assert [e.fields["Number"] for e in first[:3]] == [0, 1, 2]
    delivery.trigger(event(10))
    assert [e.fields["Number"] for e in newest.taken()] == [10]


def test_an_item_that_was_switched_off_judges_nothing_more(delivery, clock):
    (slow,) = watching(delivery, Subscription(1, clock, cost=0.001))
    for number in range(5):
        delivery.trigger(event(number))
    slow.item.set_mode(ua.MonitoringMode.Disabled)
    clock.advance(1.0)
    assert slow.taken() == []
    assert slow.charged < 0.001


def test_what_stands_is_told_once_to_who_listens_and_to_who_begins_to(delivery, clock):
    early, late = Subscription(1, clock), Subscription(2, clock)
    delivery.watch(early, early.item)
    delivery.stand(event(1, SERVER), 600.0)
    delivery.watch(late, late.item)
    delivery.welcome(late, late.item)
    assert [len(early.taken()), len(late.taken())] == [1, 1]


def test_what_stands_is_for_its_emitters_its_audience_and_its_time(delivery, clock):
    delivery.stand(event(1, SERVER), 600.0)
    delivery.stand(event(2, SERVER, audience=Role.SECURITY_ADMIN), 600.0)
    elsewhere, here, after = (
        Subscription(number, clock, node=node)
        for number, node in enumerate((PLANT, SERVER, SERVER), 1)
    )
    for subscription in (elsewhere, here):
        delivery.welcome(subscription, subscription.item)
    clock.advance(600.0)
    delivery.welcome(after, after.item)
    assert [len(one.taken()) for one in (elsewhere, here, after)] == [0, 1, 0]


def test_only_the_newest_of_what_stands_are_told(delivery, clock):
    for number in range(30):
        delivery.stand(event(number, SERVER), 600.0)
    newcomer = Subscription(1, clock)
    delivery.welcome(newcomer, newcomer.item)
    assert len(newcomer.taken()) == 10


class Failing(Filter):
    """Cannot judge the event number 1."""

    def passes(self, event):
        if event.fields["Number"] == 1:
            raise KeyError(1)
        return super().passes(event)


def test_an_event_that_a_filter_fails_on_is_lost_and_the_next_ones_come(delivery, clock):
    failing, other = watching(
        delivery, Subscription(1, clock, cost=1e-5), Subscription(2, clock, cost=1e-5)
    )
    failing.item.modify(Listening(1, Failing(clock, 1e-5), 1_000, discard_oldest=True))
    for number in range(4):
        delivery.trigger(event(number))
    clock.advance(0.1)
    delivery.trigger(event(4))
    clock.advance(0.1)
    heard = failing.taken()
    assert [e.fields["Number"] for e in heard if e.kind != OVERFLOW] == [0, 2, 3, 4]
    assert [e.kind for e in heard].count(OVERFLOW) == 1
    assert [e.fields["Number"] for e in other.taken()] == [0, 1, 2, 3, 4]
