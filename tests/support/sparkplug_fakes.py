"""A broker and a service without a network, for the tests of what goes between them."""

import asyncio
import json
from dataclasses import dataclass, field

from support import readings
from valvemap.errors import CommandRejected, SinkLost, SourceLost, SourceRejected
from valvemap.sparkplug.edge_node import Message
from valvemap.sparkplug.metrics import Meaning
from valvemap.sparkplug.schema import Payload


@dataclass
class FakeSession:
    """Fulfils `valvemap.sparkplug.ports.Session`: notes what is published."""

    broker: "FakeBroker"
    pending: list = field(default_factory=list)
    asked: list = field(default_factory=list)
    closed: bool = False

    def publish(self, message):
        self._check()
        self.pending.append(message)

    async def confirm(self):
        self._check()
        await self.broker.answers.wait()
        self._check()
        self.broker.said += self.pending
        self.pending = []

    def received(self):
        self._check()
        taken, self.asked = self.asked, []
        return taken

    async def close(self):
        self.closed = True

    def _check(self):
        if not self.broker.up:
            raise SinkLost("mqtt://fake: the connection broke")


class FakeBroker:
    """Fulfils `valvemap.sparkplug.ports.Broker`; ``said`` is what surely arrived."""

    url = "mqtt://fake:1"
    refused_packets = 0
    lost_messages = 0

    def __init__(self):
        self.up = True
        self.answers = asyncio.Event()
        self.answers.set()
        self.said, self.wills, self.sessions = [], [], []

    async def connect(self, will, topics):
        self.wills.append(will)
        self.topics = list(topics)
        if not self.up:
            raise SinkLost("mqtt://fake: connection refused")
        self.sessions.append(FakeSession(self))
        return self.sessions[-1]

    def ask(self, name="Node Control/Rebirth", payload=None):
        """Send a command to who is connected."""
        if payload is None:
            message = Payload()
            message.metrics.add(name=name, boolean_value=True)
            payload = message.SerializeToString()
        self.sessions[-1].asked.append(Message(self.topics[0], payload))

    def command(self, device, payload, *, retained=False):
        """Send a command to a device of who is connected, if it has subscribed to commands."""
        start = self.topics[0].replace("/NCMD/", "/DCMD/")
        assert f"{start}/+" in self.topics
        message = Message(f"{start}/{device}", payload, retained=retained)
        self.sessions[-1].asked.append(message)

    def say_state(self, online, timestamp):
        """Say what a primary host says of itself."""
        payload = json.dumps({"online": online, "timestamp": timestamp}).encode()
        self.sessions[-1].asked.append(Message(self.topics[1], payload))

    def verbs(self):
        return [message.topic.split("/")[2] for message in self.said]

    def metrics(self, *verbs):
        """All metrics of messages of some verbs, in their order."""
        return [
            metric
            for message in self.said
            if message.topic.split("/")[2] in verbs
            for metric in Payload.FromString(message.payload).metrics
        ]


@dataclass(frozen=True)
class Read(readings.Read):
    t: int = 1_790_000_000_000_000_000


class FakeService:
    """Fulfils `valvemap.sparkplug.ports.Service`: ``variables`` by id, each (type, Read).

    ``given`` are the commands that it carried out; ``may_write`` is the role of the log-in.
    """

    url = "opc.tcp://fake:1/service/"

    def __init__(self, variables, meanings=None):
        self.variables, self.meanings = dict(variables), meanings or {}
        self.up, self.has_room, self.lost = True, True, 0
        self.sent, self.watched, self.browsed = [], (), []
        self.version = "1"
        self.given, self.may_write = [], True

    async def connect(self):
        self._check()
        self.lost = 0

    async def close(self):
        pass

    async def browse_each(self, ids):
        self._check()
        self.browsed += ids
        return [self._below(id_) for id_ in ids]

    def _below(self, id_):
        start = "" if id_ == "Identification" else f"{id_}."
        found = {}
        for whole in self.variables:
            if whole.startswith(start):
                name = start + whole[len(start) :].partition(".")[0]
                found[name] = readings.Node(name, is_variable=name in self.variables)
        methods = ("Acknowledge", "Confirm") if ".Alarms." in start else ("Reset",)
        return [*found.values(), *(readings.Node(f"{start}{m}", is_method=True) for m in methods)]

    async def scalar_types(self, ids):
        return [self.variables[id_][0] for id_ in ids]

    async def engineering(self, ids):
        return [self.meanings.get(id_, Meaning()) for id_ in ids]

    async def read(self, ids):
        self._check()
        return [self._one(id_) for id_ in ids]

    def _one(self, id_):
        if id_ == "Identification.NodeVersion":
            return Read(self.version)
        return Read(0) if isinstance(id_, int) else self.variables[id_][1]

    async def watch(self, ids, _every_s):
        self._check()
        if not self.has_room:
            raise SourceRejected("opc.tcp://fake: BadTooManyMonitoredItems")
        self.watched = tuple(ids)

    async def write(self, id_, value):
        self._give(id_, value)

    async def call(self, owner, method, inputs):
        self._give(f"{owner}.{method}", inputs)
        return [()]

    def _give(self, id_, value):
        self._check()
        if not self.may_write:
            raise CommandRejected(f"{id_}: refused by the server, BadUserAccessDenied")
        self.given.append((id_, value))

    def changes(self):
        self._check()
        taken, self.sent = self.sent, []
        return taken

    def _check(self):
        if not self.up:
            raise SourceLost("opc.tcp://fake: gone")
