"""Which commands of MQTT clients are taken, and what is counted of the others: no broker."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvemap.sparkplug.commands import MOST_METRICS, Commands
from valvemap.sparkplug.edge_node import Message
from valvemap.sparkplug.metrics import Meaning, Value
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.schema import DataType, Payload
from valvemap.sparkplug.shown import Shown, Variable
from valvemap.vocabulary.commands import NAMED

NOW = 1_790_000_000_000_000_000
SECOND = 1_000_000_000
RANGE = Meaning("l/min", (0.0, 200.0), "")
DEMAND, SEEN = "V1.Inverse.FlowDemand", "V1.Alarms.Changed.Acknowledge"
GIVES, SEES = NAMED["demand"], NAMED["acknowledge"]
SAYS = "Alarms/Changed/Acknowledge"
VARIABLES = [
    Variable(DEMAND, "V1", "Inverse/FlowDemand", DataType.DOUBLE, RANGE, GIVES),
    Variable(SEEN, "V1", SAYS, DataType.STRING, Meaning(), SEES, ""),
    Variable("V1.Signals.Q", "V1", "Signals/Q", DataType.DOUBLE, RANGE),
    Variable("V2.Inverse.FlowDemand", "V2", "Inverse/FlowDemand", DataType.DOUBLE, RANGE, GIVES),
]


@pytest.fixture
def shown():
    made = Shown(Outbox(1_000), NOW)
    made.find(VARIABLES, {v.id: Value(None, 0, NOW) for v in VARIABLES}, NOW)
    return made


@pytest.fixture
def commands(shown):
    return Commands(("demand", "acknowledge"), shown, "Valve/", max_age_s=5.0)


def payload(*metrics, sent=NOW):
    made = Payload() if sent is None else Payload(timestamp=sent // 10**6)
    for metric in metrics:
        made.metrics.add(**metric)
    return made.SerializeToString()


def hear(commands, *metrics, device="V1", sent=NOW, retained=False):
    message = Message("topic", payload(*metrics, sent=sent), retained=retained)
    commands.hear(device, message, NOW)


def taken(commands, now=NOW):
    return [(order.tag.id, order.value) for order in commands.take(now)]


def alias(shown, id_):
    return next(tag.alias for tags in shown.tags.values() for tag in tags if tag.id == id_)


def demand(value=60.0, **more):
    return {"name": "Inverse/FlowDemand", "double_value": value, **more}


def test_a_command_is_taken_by_name_by_path_by_alias_and_as_a_member_of_an_instance(
    commands, shown
):
    number = alias(shown, DEMAND)
    hear(commands, demand(1.0))
    assert taken(commands) == [(DEMAND, 1.0)]
    hear(commands, demand(2.0) | {"name": "Valve/Inverse/FlowDemand"})
    assert taken(commands) == [(DEMAND, 2.0)]
    hear(commands, {"alias": number, "double_value": 3.0})
    assert taken(commands) == [(DEMAND, 3.0)]
    made = Payload(timestamp=NOW // 10**6)
    template = made.metrics.add(name="Valve", datatype=DataType.TEMPLATE).template_value
    template.metrics.add(name="Inverse/FlowDemand", double_value=4.0, datatype=DataType.DOUBLE)
    commands.hear("V1", Message("topic", made.SerializeToString()), NOW)
    assert taken(commands) == [(DEMAND, 4.0)]
    hear(commands, {"name": SAYS, "string_value": ""})
    assert taken(commands) == [(SEEN, "")]
    assert (commands.refused, commands.lost) == (0, 0)


@pytest.mark.parametrize(
    ("metric", "why"),
    [
        (demand(math.nan), "finite"),
        (demand(math.inf), "finite"),
        (demand(1e308), "outside 0 to 200"),
        (demand(-1.0), "outside 0 to 200"),
        (demand(datatype=DataType.FLOAT), "type Double"),
        ({"name": "Inverse/FlowDemand", "string_value": "60"}, "type Double"),
        ({"name": "Inverse/FlowDemand", "float_value": 60.0}, "type Double"),
        ({"name": "Inverse/FlowDemand", "is_null": True}, "type Double"),
        ({"name": "Inverse/FlowDemand"}, "type Double"),
        (demand(name="Inverse/RequiredU"), "no such metric"),
        (demand(name="x" * 60_000), "no such metric"),
        (demand(name="Valve/Valve/Inverse/FlowDemand"), "no such metric"),
        ({"alias": 2**64 - 1, "double_value": 60.0}, "no such metric"),
        (demand(alias=3), "no such metric"),  # the alias of another
        (demand(name="Signals/Q"), "takes no command"),
        ({"double_value": 60.0}, "neither name nor alias"),
        ({"name": SAYS, "string_value": "x" * 201}, "200 characters"),
        ({"name": SAYS, "string_value": "a\nb"}, "one line"),
        ({"name": SAYS, "double_value": 1.0}, "type String"),
    ],
)
def test_what_is_absurd_is_refused_and_counted_with_its_reason(commands, metric, why):
    hear(commands, metric)
    assert taken(commands) == []
    assert (commands.refused, commands.lost) == (1, 0)
    assert why in commands.last_refusal
    assert len(commands.last_refusal) < 300


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"sent": NOW - 6 * SECOND}, "6 s old; 5 s are allowed"),
        ({"sent": NOW + 6 * SECOND}, "-6 s old"),
        ({"sent": None}, "no timestamp"),
        ({"sent": (2**64 - 1) * 10**6}, "s old"),
        ({"retained": True}, "retained"),
        ({"device": "V9"}, "V9 Inverse/FlowDemand: there is no such metric"),
        ({"device": ""}, "no such metric"),
        ({"device": "\x1b[2J\ud800"}, "no such metric"),
    ],
)
def test_an_old_future_retained_or_foreign_command_is_refused(commands, more, why):
    hear(commands, demand(), **more)
    assert taken(commands) == []
    assert (commands.refused, commands.lost) == (1, 0)
    assert why in commands.last_refusal
    assert commands.last_refusal.isprintable()


def test_rubbish_and_too_many_metrics_are_refused_whole(commands):
    for data in (b"", b"\xff\xff\xff", payload(sent=NOW), payload(*[demand()] * 101)):
        commands.hear("V1", Message("topic", data), NOW)
    made = Payload(timestamp=NOW // 10**6)
    for _ in range(MOST_METRICS + 1):
        made.metrics.add(name="Valve").template_value.metrics.add(**demand())
    commands.hear("V1", Message("topic", made.SerializeToString()), NOW)
    assert (taken(commands), commands.refused, commands.lost) == ([], 5, 0)


def test_of_each_metric_the_newest_waits_and_the_replaced_ones_are_counted(commands):
    for k in range(100):
        hear(commands, demand(float(k)))
        hear(commands, demand(float(k)), device="V2")
    assert taken(commands) == [(DEMAND, 99.0), ("V2.Inverse.FlowDemand", 99.0)]
    assert (commands.refused, commands.lost) == (0, 198)


def test_a_command_that_waited_too_long_is_refused_when_it_is_due(commands):
    hear(commands, demand())
    assert taken(commands, NOW + 6 * SECOND) == []
    assert (commands.refused, taken(commands)) == (1, [])


def test_no_command_is_taken_while_the_service_is_away(commands, shown):
    shown.lose(NOW)
    hear(commands, demand())
    assert (taken(commands), commands.refused) == ([], 1)
    assert "not connected" in commands.last_refusal


@given(st.binary(max_size=300))
def test_no_bytes_raise(data):
    made = Shown(Outbox(1_000), NOW)
    made.find(VARIABLES, {}, NOW)
    commands = Commands(("demand",), made, "", max_age_s=5.0)
    commands.hear("V1", Message("topic", data), NOW)
    assert commands.refused > 0
