"""Event filters: checked when they are made, judged with null as neither true nor false."""

import time

import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import HardenedServer, ServerSettings
from guarded_opcua.monitoring.event_filter import EventFilter, EventFilterRefused, types_above
from guarded_opcua.monitoring.events import Event
from guarded_opcua.monitoring.like_operator import like

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes, Ids, Op = ua.StatusCodes, ua.ObjectIds, ua.FilterOperator
SERVER = ua.NodeId(Ids.Server)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def aspace():
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/events/",
        application_uri="urn:test:events",
        application_name="events",
        namespace_uri="urn:events",
        none_on_loopback=True,
    )
    return (await HardenedServer.create(settings))._inside.aspace


def event(**fields):
    variants = {"Severity": ua.Variant(300, ua.VariantType.UInt16)}
    variants["Message"] = ua.Variant(ua.LocalizedText("valve 7 is clogged", "en"))
    variants |= {name: ua.Variant(value) for name, value in fields.items()}
    return Event((SERVER,), ua.NodeId(Ids.AuditWriteUpdateEventType), variants)


def field(*path, kind=Ids.BaseEventType, attribute=ua.AttributeIds.Value, part=None):
    names = [ua.QualifiedName(name) for name in path]
    return ua.SimpleAttributeOperand(ua.NodeId(kind), names, attribute, part)


def literal(value):
    return ua.LiteralOperand(ua.Variant(value))


def node(identifier):
    return literal(ua.NodeId(identifier))


def made(aspace, *elements, select=None):
    where = ua.ContentFilter([ua.ContentFilterElement(op, list(ops)) for op, *ops in elements])
    return EventFilter(aspace, ua.EventFilter(select or [field("Message")], where))


def element(number):
    return ua.ElementOperand(number)


BITS = (Op.BitwiseAnd, field("Severity"), literal(63))


@pytest.mark.parametrize(
    ("wanted", "elements"),
    [
        (True, []),
        (True, [(Op.GreaterThan, field("Severity"), literal(200))]),
        (False, [(Op.GreaterThan, field("Severity"), literal(300))]),
        (True, [(Op.GreaterThanOrEqual, field("Severity"), literal(300))]),
        (False, [(Op.LessThan, field("Severity"), literal(300))]),
        (True, [(Op.Between, field("Severity"), literal(100), literal(300))]),
        (False, [(Op.Between, field("Severity"), literal(301), literal(400))]),
        (True, [(Op.InList, field("Severity"), literal(1), literal(300))]),
        (False, [(Op.InList, field("Severity"), literal(1), literal("300"))]),
        (True, [(Op.Like, field("Message"), literal("valve _ is %"))]),
        (False, [(Op.Like, field("Severity"), literal("%"))]),
        (True, [(Op.IsNull, field("Nothing"))]),
        (False, [(Op.Equals, field("Nothing"), literal(1))]),
        (False, [(Op.Not, element(1)), (Op.Equals, field("Nothing"), literal(1))]),
        (False, [(Op.GreaterThan, field("Message"), literal(1))]),
        (True, [(Op.OfType, node(Ids.AuditWriteUpdateEventType))]),
        (True, [(Op.OfType, node(Ids.AuditEventType))]),
        (True, [(Op.OfType, node(Ids.BaseEventType))]),
        (False, [(Op.OfType, node(Ids.AuditSessionEventType))]),
        (True, [(Op.Equals, element(1), literal(44)), BITS]),
        (
            True,
            [
                (Op.Or, element(1), element(2)),
                (Op.Equals, field("Nothing"), literal(1)),
                (Op.And, element(3), element(4)),
                (Op.Equals, field("Severity"), literal(300)),
                (Op.OfType, node(Ids.AuditEventType)),
            ],
        ),
    ],
)  # fmt: skip
async def test_a_filter_passes_what_it_says(aspace, wanted, elements):
    assert made(aspace, *elements).passes(event()) is wanted


@pytest.mark.parametrize(
    "elements",
    [
        [(Op.Equals, field("Severity"))],
        [(Op.Not,)],
        [(Op.InView, literal(1))],
        [(Op.RelatedTo, *[literal(1)] * 6)],
        [(Op.Cast, literal(1), node(1))],
        [(Op.Not, element(0))],
        [(Op.Not, element(1))],
        [(Op.And, element(1), element(1)), (Op.IsNull, field("Message"))],
        [(Op.Not, element(1)), (Op.Not, element(0))],
        [(Op.IsNull, ua.AttributeOperand())],
        [(Op.IsNull, field("Message", part="0:1"))],
        [(Op.IsNull, field(*"x" * 51))],
        [(Op.InList, *[literal(1)] * 101)],
        [(Op.IsNull, field("Message"))] * 21,
    ],
)
async def test_a_filter_that_we_do_not_answer_is_refused(aspace, elements):
    with pytest.raises(EventFilterRefused):
        made(aspace, *elements)


@pytest.mark.parametrize("wish", [None, ua.DataChangeFilter(), ua.EventFilter()])
async def test_what_selects_nothing_is_refused(aspace, wish):
    with pytest.raises(EventFilterRefused):
        EventFilter(aspace, wish)
    with pytest.raises(EventFilterRefused):
        EventFilter(aspace, ua.EventFilter([field("Message")] * 201, ua.ContentFilter()))


async def test_each_select_clause_is_answered_and_what_is_missing_is_null(aspace):
    found = made(
        aspace,
        select=[
            field("Severity"),
            field("Nothing"),
            field("Severity", kind=Ids.BaseObjectType),
            field("Severity", kind=99_999),
            field("Severity", part="0:1"),
            field("Severity", attribute=ua.AttributeIds.DisplayName),
            field(attribute=ua.AttributeIds.NodeId),
            field("Part", "Whole"),
        ],
    )
    assert found.results == [
        Codes.Good,
        Codes.Good,
        Codes.BadTypeDefinitionInvalid,
        Codes.BadTypeDefinitionInvalid,
        Codes.BadIndexRangeInvalid,
        Codes.BadAttributeIdInvalid,
        Codes.BadAttributeIdInvalid,
        Codes.Good,
    ]
    selected = found.select(event(**{"Part/Whole": 5.0}))
    assert [field_.Value for field_ in selected] == [300, None, None, None, None, None, None, 5.0]


CONDITION = ua.NodeId("valve 7 is clogged", 2)


@pytest.mark.parametrize("kind", [Ids.ConditionType, Ids.ExclusiveDeviationAlarmType])
async def test_the_node_of_a_condition_type_is_its_condition_id(aspace, kind):
    condition_id = field(kind=kind, attribute=ua.AttributeIds.NodeId)
    same = (Op.Equals, condition_id, literal(CONDITION))
    found = made(aspace, same, select=[condition_id])
    alarm = Event(SERVER, ua.NodeId(kind), {}, condition=CONDITION)
    assert found.results == [Codes.Good]
    assert found.select(alarm) == [ua.Variant(CONDITION, ua.VariantType.NodeId)]
    assert found.passes(alarm)
    assert found.select(event()) == [ua.Variant()]
    assert not found.passes(event())


@pytest.mark.parametrize(
    "operand",
    [
        field(attribute=ua.AttributeIds.NodeId),
        field(kind=Ids.AuditEventType, attribute=ua.AttributeIds.NodeId),
        field("Message", kind=Ids.ConditionType, attribute=ua.AttributeIds.NodeId),
        field(kind=Ids.ConditionType),
    ],
    ids=["base", "audit", "path", "value"],
)
async def test_no_other_node_is_answered(aspace, operand):
    assert made(aspace, select=[operand]).results == [Codes.BadAttributeIdInvalid]
    with pytest.raises(EventFilterRefused):
        made(aspace, (Op.IsNull, operand))


async def test_the_types_above_end_at_the_base(aspace):
    above = types_above(aspace, ua.NodeId(Ids.AuditWriteUpdateEventType))
    assert above[1:4] == [
        ua.NodeId(Ids.AuditUpdateEventType),
        ua.NodeId(Ids.AuditEventType),
        ua.NodeId(Ids.BaseEventType),
    ]
    assert types_above(aspace, ua.NodeId("nothing", 9)) == [ua.NodeId("nothing", 9)]


@pytest.mark.parametrize(
    ("text", "pattern", "fits"),
    [
        ("", "", True),
        ("", "%", True),
        ("", "_", False),
        ("ab", "a", False),
        ("ab", "%b", True),
        ("abc", "a%c", True),
        ("abcd", "a%c", False),
        ("aXbXc", "%X%c", True),
        ("b", "[a-c]", True),
        ("d", "[^a-c]", True),
        ("b", "[^a-c]", False),
        ("-", "[a-]", True),
        ("[", "[", True),
        ("%", r"\%", True),
        ("x", r"\%", False),
        ("\\", "\\", True),
    ],
)
async def test_like_matches_as_the_standard_says(text, pattern, fits):
    assert like(text, pattern) is fits


async def test_like_takes_no_pattern_for_long():
    began = time.process_time()
    for pattern in ("%a" * 1_000, "%a" * 49 + "%b"):
        assert not like("a" * 100_000, pattern)
    assert time.process_time() - began < 0.5
