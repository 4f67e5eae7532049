"""From a service to a broker, both without a network: losses, returns, births, counts."""

import asyncio
from contextlib import asynccontextmanager
from itertools import repeat

import pytest

from support.exposition import names, promtool_accepts, value
from support.sparkplug_fakes import FakeBroker, FakeService, Read
from valvemap.app.mqtt_metrics import mqtt_points
from valvemap.clock import SystemClock
from valvemap.errors import ConfigurationError
from valvemap.page.exposition import exposition
from valvemap.sparkplug.broker import PahoBroker
from valvemap.sparkplug.commands import Commands
from valvemap.sparkplug.edge_node import EdgeNode
from valvemap.sparkplug.host import PrimaryHost
from valvemap.sparkplug.metrics import Meaning
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.reader import Reader
from valvemap.sparkplug.schema import Payload
from valvemap.sparkplug.sender import Sender
from valvemap.sparkplug.settings import BrokerSettings
from valvemap.sparkplug.shown import Shown
from valvemap.vocabulary.series import OF_MQTT

VARIABLES = {
    "V1.RLS.Residual": ("Double", Read(0.5)),
    "V1.RLS.Status": ("Int32", Read(0)),
    "V1.RLS.Coverage": (None, Read([[1.0]])),
    "V1.Alarms.Changed.Active": ("Boolean", Read(value=False)),
    "V1.Alarms.Changed.Condition.Retain": ("Boolean", Read(value=False)),
    "V1.Inverse.FlowDemand": ("Double", Read(20.0)),
    "Service.Checkpoint.Age": ("Double", Read(3.0)),
}
DEMAND = "V1.Inverse.FlowDemand"
RESIDUAL = "V1.RLS.Residual"
EVERY_S = 0.02


class Whole:
    """Reader and sender, as `valvemap mqtt` has them."""

    def __init__(self, variables, wanted, most, host=None, meanings=None, allowed=()):
        clock = SystemClock()
        self.broker, self.service = FakeBroker(), FakeService(variables, meanings)
        self.outbox = Outbox(most)
        self.shown = Shown(self.outbox, clock.now())
        pauses = lambda: repeat(0.01)  # noqa: E731
        node = EdgeNode("G", "N")
        self.commands = Commands(allowed, self.shown, "", 5.0) if allowed else None
        self.reader = Reader(
            self.service, self.shown, wanted, EVERY_S, clock, pauses, self.commands
        )
        self.sender = Sender(
            self.broker, node, self.shown, self.outbox, EVERY_S, clock, pauses, host, self.commands
        )

    async def until(self, condition):
        async with asyncio.timeout(20.0):
            while not condition():  # noqa: ASYNC110 - polled
                await asyncio.sleep(0.01)

    async def births(self, devices):
        """Wait for an edge node's birth that is followed by so many of devices."""
        await self.until(lambda: self.broker.verbs().count("DBIRTH") >= devices)

    def send(self, value, code=0, id_=RESIDUAL):
        self.service.sent.append((id_, Read(value, code)))

    def values(self):
        """What DDATA said of the residual, in its order: value, whether it is historical."""
        return [
            (metric.double_value, metric.is_historical)
            for metric in self.broker.metrics("DDATA")
            if metric.alias == self.alias(RESIDUAL)
        ]

    def alias(self, id_):
        return next(t.alias for tags in self.shown.tags.values() for t in tags if t.id == id_)

    def newest(self, name):
        """What the node said last of one of its metrics."""
        aliases = {m.name: m.alias for m in self.broker.metrics("NBIRTH")}
        said = self.broker.metrics("NBIRTH", "NDATA")
        return next(m for m in reversed(said) if m.alias == aliases[name])

    async def knows(self, value):
        """Wait until the residual is known to be this."""
        await self.until(lambda: self.shown.newest[RESIDUAL].value == value)


@asynccontextmanager
async def running(wanted=("*",), most=1_000, **more):
    whole = Whole(VARIABLES, wanted, most, **more)
    tasks = [asyncio.create_task(whole.reader.run()), asyncio.create_task(whole.sender.run())]
    try:
        yield whole
    finally:
        for task in reversed(tasks):
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
    assert all(task.cancelled() for task in tasks)


async def test_births_hold_every_scalar_and_no_table_and_no_condition():
    async with running() as whole:
        await whole.births(1)
        assert {m.name for m in whole.broker.metrics("DBIRTH")} == {
            "RLS/Residual",
            "RLS/Status",
            "Alarms/Changed/Active",
            "Alarms/Changed/Meaning",
            "Inverse/FlowDemand",
        }
        names = {m.name for m in whole.broker.metrics("NBIRTH")}
        assert {"bdSeq", "Node Control/Rebirth", "Service/Checkpoint/Age", "MQTT/Lost"} <= names
        assert not any("Condition" in id_ for id_ in whole.service.browsed)


async def test_births_say_unit_range_and_description_and_data_do_not():
    meanings = {RESIDUAL: Meaning("l/min", (-90.0, 90.0), "Q less its prediction.")}
    async with running(meanings=meanings) as whole:
        await whole.births(1)
        whole.send(0.9)
        await whole.knows(0.9)
        await whole.until(whole.values)
    born = [m for m in whole.broker.metrics("DBIRTH") if m.name == "RLS/Residual"][-1]
    said = {
        key: value.string_value or value.double_value
        for key, value in zip(born.properties.keys, born.properties.values, strict=True)
        if key not in {"Quality", "StatusCode"}
    }
    described = {"documentation": "Q less its prediction."}
    assert said == {"engUnit": "l/min", "engLow": -90.0, "engHigh": 90.0} | described
    assert all(list(m.properties.keys) == ["Quality"] for m in whole.broker.metrics("DDATA"))


async def test_valves_that_come_while_the_service_runs_are_born(monkeypatch):
    monkeypatch.setattr("valvemap.sparkplug.reader._ASK_S", 0.0)
    async with running(wanted=("V*", "RLS.*")) as whole:
        await whole.births(1)
        whole.service.variables["V2.RLS.Residual"] = ("Double", Read(0.7))
        whole.service.version = "2"
        await whole.births(3)  # the first one again, and the new one
        topics = {topic for topic in whole.shown.tags if topic}
        assert topics == {"V1", "V2"}


async def test_each_alarm_says_what_it_means_in_its_birth():
    meanings = {"V1.Alarms.Changed": Meaning(description="The flow changed. Check the meter.")}
    async with running(meanings=meanings, wanted=("Alarms.*",)) as whole:
        await whole.births(1)
        assert "V1.Alarms.Changed.Meaning" not in whole.service.watched
    born = {m.name: m for m in whole.broker.metrics("DBIRTH")}
    assert born["Alarms/Changed/Meaning"].string_value == "The flow changed. Check the meter."


async def test_patterns_choose_what_is_sent():
    async with running(wanted=("*.Residual", "Service.*")) as whole:
        await whole.births(1)
        assert set(whole.service.watched) == {RESIDUAL, "Service.Checkpoint.Age"}


async def test_what_changes_is_sent_once_and_what_does_not_is_not():
    async with running() as whole:
        await whole.births(1)
        for value in (0.5, 0.7, 0.7, 0.9):
            whole.send(value)
        await whole.until(lambda: len(whole.values()) >= 2)
        assert whole.values() == [(0.7, False), (0.9, False)]


async def test_a_broker_that_comes_back_gets_births_and_then_all_that_was_missed_as_history():
    async with running() as whole:
        await whole.births(1)
        whole.broker.up = False
        await whole.until(lambda: len(whole.broker.wills) >= 3)  # it was tried again
        for k in range(5):
            whole.send(10.0 + k)
        await whole.until(lambda: whole.outbox.newest >= 5)
        whole.broker.up = True
        await whole.until(lambda: len(whole.values()) >= 5)
        assert whole.values() == [(10.0 + k, True) for k in range(5)]
        verbs = whole.broker.verbs()
        birth = len(verbs) - 1 - verbs[::-1].index("DBIRTH")
        assert "DDATA" not in verbs[:birth]
        born = [m for m in whole.broker.metrics("DBIRTH") if m.name == "RLS/Residual"]
        assert born[-1].double_value == 14.0
        whole.send(20.0)
        await whole.until(lambda: whole.values()[-1] == (20.0, False))


async def test_every_connection_has_its_own_bdseq_and_its_birth_the_same():
    async with running() as whole:
        await whole.births(1)
        whole.broker.up = False
        await whole.until(lambda: len(whole.broker.wills) >= 3)
        whole.broker.up = True
        before = len(whole.broker.said)
        await whole.until(lambda: "NBIRTH" in whole.broker.verbs()[before:])
        wills = [Payload.FromString(w.payload).metrics[0].long_value for w in whole.broker.wills]
        assert wills == list(range(len(wills)))
        births = [m.long_value for m in whole.broker.metrics("NBIRTH") if m.name == "bdSeq"]
        assert births[-1] == wills[-1]


async def test_what_a_break_left_unconfirmed_is_sent_again():
    async with running() as whole:
        await whole.births(1)
        await whole.until(lambda: not len(whole.outbox))
        whole.broker.answers.clear()  # it takes what it is sent, and says nothing
        whole.send(0.7)
        await whole.until(lambda: any("DDATA" in m.topic for m in whole.broker.sessions[0].pending))
        whole.broker.up = False
        whole.broker.answers.set()
        await whole.until(lambda: whole.broker.sessions[0].closed)
        whole.broker.up = True
        await whole.until(lambda: (0.7, True) in whole.values())


async def test_a_broker_that_stands_still_costs_no_memory_and_the_oldest_are_counted():
    async with running(most=50) as whole:
        await whole.births(1)
        whole.broker.answers.clear()
        for k in range(500):
            whole.send(float(k))
        await whole.until(lambda: whole.outbox.newest >= 500)
        assert len(whole.outbox) <= 50
        whole.broker.answers.set()
        await whole.until(lambda: whole.values() and whole.values()[-1][0] == 499.0)
        await whole.until(lambda: whole.newest("MQTT/Lost").long_value == whole.outbox.lost)
        of_node = sum(m.alias != 0 for m in whole.broker.metrics("NDATA"))
        assert whole.outbox.lost >= 500 - len(whole.values()) - of_node > 0


async def test_a_service_that_goes_is_a_death_of_its_devices_and_nothing_of_it_is_good():
    async with running() as whole:
        await whole.births(1)
        whole.service.up = False
        await whole.until(lambda: "DDEATH" in whole.broker.verbs())
        age = whole.newest("Service/Checkpoint/Age")
        assert (age.is_null, age.properties.values[0].int_value) == (True, 0)
        assert whole.newest("MQTT/ServiceConnected").boolean_value is False
        whole.service.up = True
        await whole.births(2)
        await whole.until(lambda: whole.newest("MQTT/ServiceConnected").boolean_value)


async def test_without_a_service_the_node_is_born_alone():
    whole = Whole(VARIABLES, ("*",), 1_000)
    whole.service.up = False
    tasks = [asyncio.create_task(whole.reader.run()), asyncio.create_task(whole.sender.run())]
    await whole.until(lambda: whole.broker.said)
    assert whole.broker.verbs() == ["NBIRTH"]
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_valves_that_are_others_after_a_return_are_born_anew_and_keep_their_aliases():
    async with running() as whole:
        await whole.births(1)
        alias = whole.alias(RESIDUAL)
        whole.service.up = False
        await whole.until(lambda: "DDEATH" in whole.broker.verbs())
        whole.service.variables = {
            "V2.RLS.Residual": ("Double", Read(1.0)),
            RESIDUAL: ("Double", Read(2.0)),
        }
        whole.service.up = True
        await whole.births(3)
        assert whole.broker.said[-1].topic.startswith("spBv1.0/G/")
        assert whole.alias(RESIDUAL) == alias != whole.alias("V2.RLS.Residual")


@pytest.mark.waits
async def test_a_request_brings_births_under_the_same_bdseq_and_rubbish_brings_nothing():
    async with running() as whole:
        await whole.births(1)
        whole.broker.ask(payload=b"\xff\xff\xff")
        whole.broker.ask("Node Control/Reboot")
        whole.broker.ask()
        await whole.births(2)
        assert [m.long_value for m in whole.broker.metrics("NBIRTH") if m.name == "bdSeq"][-2:] == [
            0,
            0,
        ]
        births = [m for m in whole.broker.said if "/NBIRTH/" in m.topic]
        assert [Payload.FromString(m.payload).seq for m in births] == [0] * len(births)


@pytest.mark.waits
async def test_many_requests_bring_one_birth():
    async with running() as whole:
        await whole.births(1)
        for _ in range(50):
            whole.broker.ask()
        await whole.births(2)
        whole.send(0.7)
        await whole.until(whole.values)
        assert whole.broker.verbs().count("DBIRTH") == 2


async def test_values_that_the_service_dropped_are_counted_and_the_rest_keeps_its_status():
    async with running() as whole:
        await whole.births(1)
        whole.send(0.7, 0x4000_0480)
        await whole.until(lambda: whole.newest("MQTT/Overflows").long_value == 1)
        await whole.until(whole.values)
        (metric,) = [m for m in whole.broker.metrics("DDATA") if m.double_value == 0.7]
        assert metric.properties.values[1].int_value == 0x4000_0000


async def test_where_more_came_than_was_taken_it_is_counted_and_all_is_read_anew():
    async with running() as whole:
        await whole.births(1)
        whole.service.variables[RESIDUAL] = ("Double", Read(0.9))
        whole.service.lost = 3
        await whole.births(2)
        await whole.until(lambda: whole.newest("MQTT/Overflows").long_value == 3)
        await whole.knows(0.9)


async def test_a_service_without_room_is_said_with_its_remedy(capsys):
    whole = Whole(VARIABLES, ("*",), 1_000)
    whole.service.has_room = False
    task = asyncio.create_task(whole.reader.run())
    heard = ""
    async with asyncio.timeout(20.0):
        while "mqtt.variables" not in heard:
            await asyncio.sleep(0.01)
            heard += capsys.readouterr().out
    task.cancel()
    assert "5 variables are watched" in heard or "4 variables are watched" in heard


async def test_at_the_end_what_waits_is_sent_and_then_the_death():
    async with running() as whole:
        await whole.births(1)
        whole.broker.answers.clear()
        whole.send(0.7)
        await whole.knows(0.7)
        whole.broker.answers.set()
    assert whole.values() == [(0.7, False)]
    assert whole.broker.verbs()[-1] == "NDEATH"
    assert whole.broker.sessions[-1].closed


async def test_a_primary_host_is_waited_for_and_what_comes_without_it_waits():
    async with running(host=PrimaryHost("SCADA")) as whole:
        await whole.until(lambda: whole.broker.sessions and whole.shown.is_connected)
        assert whole.broker.topics == ["spBv1.0/G/NCMD/N", "spBv1.0/STATE/SCADA"]
        whole.send(0.7)
        await whole.knows(0.7)
        assert whole.broker.said == []
        whole.broker.say_state(online=True, timestamp=10)
        await whole.until(lambda: whole.values() == [(0.7, True)])
        whole.broker.say_state(online=False, timestamp=9)  # of before
        whole.send(0.8)
        await whole.until(lambda: whole.values()[-1] == (0.8, False))
        whole.broker.say_state(online=False, timestamp=11)
        await whole.until(lambda: len(whole.broker.sessions) == 2)
        assert whole.broker.verbs()[-1] == "NDEATH"
        whole.send(0.9)
        await whole.knows(0.9)
        whole.broker.say_state(online=True, timestamp=12)
        await whole.until(lambda: whole.values()[-1] == (0.9, True))
        assert whole.broker.verbs().count("NBIRTH") >= 2


@pytest.mark.parametrize(
    "payload",
    [
        *(b"", b"ONLINE", b"[]", b"\xff", b"[" * 100_000, b'{"online": true}'),
        *(b'{"online": 1, "timestamp": 5}', b'{"online": true, "timestamp": -1}'),
        b'{"online": true, "timestamp": 1e400}',
    ],
)
def test_what_is_no_state_brings_no_host(payload):
    host = PrimaryHost("SCADA")
    host.hear(payload)
    assert not host.is_online


@pytest.mark.parametrize("up", [True, False])
async def test_it_ends_at_once_whether_there_is_a_broker_or_not(up):
    async with running() as whole:
        whole.broker.up = up
        await whole.until(lambda: whole.broker.wills)


async def test_a_file_of_certificates_that_is_not_there_is_named_before_anything_is_tried(tmp_path):
    with pytest.raises(ConfigurationError, match=r"ca\.pem: no such file"):
        PahoBroker(BrokerSettings("h", 1, "c", tls=True, ca_file=tmp_path / "ca.pem"))
    (tmp_path / "ca.pem").write_text("nonsense")
    with pytest.raises(ConfigurationError, match=r"ca\.pem: cannot be used"):
        PahoBroker(BrokerSettings("h", 1, "c", tls=True, ca_file=tmp_path / "ca.pem"))


async def test_metrics_show_the_queue_its_losses_and_both_connections():
    async with running(most=1_000) as whole:
        await whole.births(1)
        await whole.until(lambda: whole.sender.is_sending and len(whole.outbox) == 0)
        text = metrics_of(whole)
        assert value(text, "valvemap_broker_up") == value(text, "valvemap_service_up") == 1
        assert value(text, "valvemap_mqtt_metrics") >= 5
        assert value(text, "valvemap_mqtt_connections_total") == 1
        whole.broker.up = False
        for k in range(1_100):
            whole.send(float(k))
        await whole.until(lambda: whole.outbox.lost and not whole.sender.is_sending)
        whole.service.up = False
        await whole.until(lambda: not whole.shown.is_connected)
        await whole.until(lambda: value(metrics_of(whole), "valvemap_mqtt_lost_values_total"))
        text = metrics_of(whole)
        assert value(text, "valvemap_broker_up") == value(text, "valvemap_service_up") == 0
        assert value(text, "valvemap_mqtt_waiting_values") == 1_000
    apart = {"valvemap_build_info", "valvemap_exporter_refused_total"}  # the exporter's own
    assert names(text) == {one.shown for one in OF_MQTT} - apart
    promtool_accepts(text)


def metrics_of(whole):
    return exposition(mqtt_points(whole.shown, whole.outbox, whole.sender, 1_000)).decode()


def demand(value, name="Inverse/FlowDemand"):
    payload = Payload(timestamp=SystemClock().now() // 10**6)
    payload.metrics.add(name=name, double_value=value)
    return payload.SerializeToString()


def acknowledgement(text):
    payload = Payload(timestamp=SystemClock().now() // 10**6)
    payload.metrics.add(name="Alarms/Changed/Acknowledge", string_value=text)
    return payload.SerializeToString()


ALLOWED = ("demand", "acknowledge")


async def test_without_commands_no_topic_of_them_is_subscribed_to_and_no_metric_is_added():
    async with running() as whole:
        await whole.births(1)
        assert whole.broker.topics == ["spBv1.0/G/NCMD/N"]
        assert "Alarms/Changed/Acknowledge" not in {t.name for t in whole.shown.tags["V1"]}
        assert not any(tag.action for tag in whole.shown.tags["V1"])


async def test_allowed_commands_are_given_to_the_service_and_counted():
    async with running(wanted=("RLS.*",), allowed=ALLOWED) as whole:
        await whole.births(1)
        whole.broker.command("V1", demand(60.0))
        whole.broker.command("V1", acknowledgement("seen"))
        await whole.until(lambda: len(whole.service.given) == 2)
        seen = ("V1.Alarms.Changed.Acknowledge", [["seen"]])
        assert whole.service.given == [(DEMAND, 60.0), seen]
        await whole.until(lambda: whole.newest("MQTT/CommandsDone").long_value == 2)
        assert whole.newest("MQTT/CommandsRefused").long_value == 0


async def test_a_command_that_is_not_allowed_is_no_command():
    async with running(allowed=("acknowledge",)) as whole:
        await whole.births(1)
        whole.broker.command("V1", demand(60.0))
        await whole.until(lambda: whole.newest("MQTT/CommandsRefused").long_value == 1)
        assert whole.service.given == []
        reason = whole.newest("MQTT/LastRefusal").string_value
        assert reason == "V1 Inverse/FlowDemand: this metric takes no command"


async def test_the_services_role_decides_and_its_word_is_published():
    async with running(allowed=ALLOWED) as whole:
        await whole.births(1)
        whole.service.may_write = False
        for _ in range(3):
            whole.broker.command("V1", demand(60.0))
            await asyncio.sleep(0.15)
        await whole.until(lambda: whole.newest("MQTT/CommandsRefused").long_value == 3)
        reason = whole.newest("MQTT/LastRefusal").string_value
        assert reason == f"{DEMAND}: refused by the server, BadUserAccessDenied"
        whole.send(0.9)
        await whole.until(lambda: whole.values()[-1:] == [(0.9, False)])


async def test_a_flood_costs_few_writes_and_all_of_it_is_counted():
    async with running(allowed=ALLOWED) as whole:
        await whole.births(1)
        for k in range(1_000):
            whole.broker.command("V1", demand(k / 10.0))
        await whole.until(lambda: whole.commands.done + whole.commands.lost == 1_000)
        assert whole.service.given[-1] == (DEMAND, 99.9)
        assert len(whole.service.given) == whole.commands.done < 20
        await whole.until(lambda: whole.newest("MQTT/CommandsLost").long_value > 980)


async def test_a_command_while_the_service_is_away_is_refused_and_never_carried_out():
    async with running(allowed=ALLOWED) as whole:
        await whole.births(1)
        whole.service.up = False
        await whole.until(lambda: "DDEATH" in whole.broker.verbs())
        whole.broker.command("V1", demand(60.0))
        await whole.until(lambda: whole.newest("MQTT/CommandsRefused").long_value == 1)
        whole.service.up = True
        await whole.births(2)
        whole.broker.command("V1", demand(70.0))
        await whole.until(lambda: whole.service.given == [(DEMAND, 70.0)])


async def test_no_command_is_taken_while_the_primary_host_is_offline():
    async with running(allowed=ALLOWED, host=PrimaryHost("SCADA")) as whole:
        await whole.until(lambda: whole.broker.sessions and whole.shown.is_connected)
        whole.broker.command("V1", demand(60.0))
        await whole.until(lambda: whole.commands.refused == 1)
        whole.broker.say_state(online=True, timestamp=10)
        await whole.births(1)
        assert whole.service.given == []
        whole.broker.command("V1", demand(70.0))
        await whole.until(lambda: whole.service.given == [(DEMAND, 70.0)])
        whole.broker.say_state(online=False, timestamp=11)
        whole.broker.command("V1", demand(80.0))
        await whole.until(lambda: len(whole.broker.sessions) == 2)
        assert whole.service.given == [(DEMAND, 70.0)]
