"""A results server whose alarms a test raises and clears, and clients that listen to conditions."""

from contextlib import asynccontextmanager, suppress

import numpy as np
from asyncua import Client, ua

from guarded_opcua import Role, UserStore
from support.clocks import TurnedClock
from support.interoperation import identification
from support.plant import START, as_changes, plant
from support.results import results_settings
from support.stream import until
from support.users import CHEAP
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.alarm_results import Remark
from valvemap.pipeline.operator_ports import Command
from valvemap.runtime.past import PastKeeper

S = 1_000_000_000
CONDITION_TYPE = ua.NodeId(ua.ObjectIds.ConditionType)
REFRESH = ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh)
REFRESH_2 = ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh2)
METHODS = {
    "Acknowledge": ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge),
    "Confirm": ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Confirm),
    "AddComment": ua.NodeId(ua.ObjectIds.ConditionType_AddComment),
}
FIELDS = (
    *("EventId", "EventType", "SourceName", "Time", "Message", "Severity", "ConditionName"),
    *("BranchId", "Retain", "ActiveState/Id", "AckedState/Id", "ConfirmedState/Id"),
    *("EnabledState/Id", "Comment", "ClientUserId", "HighLimit", "LimitState/CurrentState/Id"),
    *("ConditionClassId", "SuppressedOrShelved", "ActiveState/TransitionTime"),
)


class Plant:
    """One valve's service, of which a lag can be found and lost again, as often as one likes."""

    def __init__(self, users, clock, store=None, **settings):
        self._store = store
        self.past = None if store is None else PastKeeper(store, ["Valvistor"])
        self._users, self.clock, self._settings = users, clock, settings
        self.live = identification()
        self.live.take(as_changes(plant(500)))
        self._taken = 500
        self.server = None

    async def start(self):
        settings = results_settings(users=self._users, none_on_loopback=True, **self._settings)
        history = {}
        if self._store is not None:
            history = {"past": self._store, "on_alarm": self.past.note_alarm}
        server = ResultsServer(settings, self.live.descriptions(), self.live, self.clock, **history)
        await server.start()
        self.server = server
        await self.publish()

    async def stop(self):
        server, self.server = self.server, None
        if server is not None:
            await server.stop()

    async def restart(self):
        """Stop, and begin anew from what was kept."""
        await self.stop()
        kept = [*self.live.states.checkpoints(), *self.live.states.memories()]
        self.live = identification()
        _, refused = self.live.restore(kept)
        assert not refused
        await self.start()

    async def set_lag(self, seconds):
        """Have a lag found: more than 0.1 s is an alarm, less than 0.08 s ends it."""
        fleet = self.live._parts.valves.fleets[0]
        fleet.alarms.note_lags(np.array([0]), np.array([seconds]))
        await self.publish()

    async def lose_sensors(self):
        self.live.say_overdue(np.array([0]), np.array([START + 600 * S]))
        await self.publish()

    async def take_samples(self):
        """Learn the next twenty samples, which ends a loss of sensors."""
        self.live.take(as_changes(plant(20, first=self._taken)))
        self._taken += 20
        await self.publish()

    async def calm(self):
        """End what there is of alarms, and have all of it acknowledged and confirmed."""
        await self.take_samples()
        await self.set_lag(0.0)
        for valve in ("Valvistor", None):
            for act, waits in (
                ("acknowledge", lambda report: not report.acked),
                ("confirm", lambda report: not report.confirmed),
            ):
                for report in filter(waits, self.live.alarms(valve)):
                    remark = Remark("", "", self.clock.now())
                    self.live.do(Command.of(act, valve, report.name, remark))
        await self.publish()

    async def publish(self):
        for results in self.live.results.of([0]):
            await self.server.publish(results)

    def report(self, name):
        return next(r for r in self.live.alarms("Valvistor") if r.name == name)


@asynccontextmanager
async def raised(**settings):
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, "correct horse")
    plant = Plant(users, TurnedClock(START + 1_000 * S), **settings)
    await plant.start()
    try:
        yield plant
    finally:
        await plant.stop()


class Event(dict):
    """The fields of an event by their paths; ``condition`` is the ConditionId."""

    def __init__(self, values):
        *values, self.condition = values
        super().__init__(zip(FIELDS, values, strict=True))

    @property
    def kind(self):
        return self["EventType"].Identifier

    @property
    def state(self):
        """Name, active, acknowledged, confirmed, retained."""
        paths = "ConditionName", "ActiveState/Id", "AckedState/Id", "ConfirmedState/Id", "Retain"
        return tuple(self[path] for path in paths)


def event_filter(*where):
    clauses = [
        ua.SimpleAttributeOperand(
            ua.NodeId(ua.ObjectIds.BaseEventType),
            [ua.QualifiedName(part) for part in path.split("/")],
            ua.AttributeIds.Value,
        )
        for path in FIELDS
    ]
    of_condition = ua.SimpleAttributeOperand(CONDITION_TYPE, [], ua.AttributeIds.NodeId)
    elements = [ua.ContentFilterElement(kind, list(operands)) for kind, *operands in where]
    return ua.EventFilter([*clauses, of_condition], ua.ContentFilter(elements))


class Listener:
    """A client that listens to the events of an object, and acts on conditions."""

    def __init__(self, client, node, filter_, queue, interval):
        self.client, self.events = client, []
        self._node, self._filter, self._queue, self._interval = node, filter_, queue, interval
        self.subscription = self.item = None

    @classmethod
    @asynccontextmanager
    async def of(cls, plant, user="operator", node=None, filter_=None, queue=0, interval=50.0):
        client = Client(plant.server.url, timeout=30.0, watchdog_intervall=30.0)
        if user is not None:
            client.set_user(user)
            client.set_password("correct horse")
        async with client:
            node = node or ua.NodeId(ua.ObjectIds.Server)
            listener = cls(client, node, filter_ or event_filter(), queue, interval)
            await listener.subscribe()
            yield listener
            with suppress(ua.UaError, ConnectionError):
                await listener.client.uaclient.delete_subscriptions([listener.subscription])

    async def subscribe(self):
        params = ua.CreateSubscriptionParameters(self._interval, 1_000, 10, 0, True, 0)  # noqa: FBT003
        session = self.client.uaclient.session
        made = await session.create_subscription(params, self._take)
        self.subscription = made.SubscriptionId
        asked = ua.MonitoringParameters(1, 0.0, self._filter, self._queue, True)  # noqa: FBT003
        wanted = ua.ReadValueId(self._node, ua.AttributeIds.EventNotifier)
        request = ua.MonitoredItemCreateRequest(wanted, ua.MonitoringMode.Reporting, asked)
        (item,) = await self.client.uaclient.create_monitored_items(
            ua.CreateMonitoredItemsParameters(
                self.subscription, ua.TimestampsToReturn.Both, [request]
            )
        )
        item.StatusCode.check()
        self.item = item.MonitoredItemId

    async def _take(self, result):
        for notification in result.NotificationMessage.NotificationData or ():
            for event in getattr(notification, "Events", ()):
                self.events.append(Event([field.Value for field in event.EventFields]))

    async def next(self, count=1):
        """Return the next events, in their order."""
        await until(lambda: len(self.events) >= count)
        taken, self.events[:count] = self.events[:count], []
        return taken

    async def act(self, name, event, comment="", event_id=None):
        """Call a condition's method; a status code."""
        given = event["EventId"] if event_id is None else event_id
        return await self.call(
            event.condition,
            METHODS[name],
            ua.Variant(given, ua.VariantType.ByteString),
            ua.Variant(ua.LocalizedText(comment), ua.VariantType.LocalizedText),
        )

    async def refresh(self, *numbers):
        method = REFRESH if not numbers else REFRESH_2
        given = [ua.Variant(n, ua.VariantType.UInt32) for n in (self.subscription, *numbers)]
        return await self.call(CONDITION_TYPE, method, *given)

    async def refreshed(self):
        """Ask for a refresh; the events of it, and that nothing was heard before it."""
        before, found = await self.until_refreshed()
        assert before == []
        return found

    async def until_refreshed(self):
        """Ask for a refresh; what was heard before it, and the events of it."""
        assert await self.refresh() == 0
        await until(lambda: any(e.kind == ua.ObjectIds.RefreshEndEventType for e in self.events))
        taken, self.events = self.events, []
        start = [e.kind for e in taken].index(ua.ObjectIds.RefreshStartEventType)
        return taken[:start], taken[start + 1 : -1]

    async def call(self, owner, method, *given):
        (result,) = await self.client.uaclient.call([ua.CallMethodRequest(owner, method, given)])
        return result.StatusCode.value

    async def namespace(self):
        return await self.client.get_namespace_index(NAMESPACE)
