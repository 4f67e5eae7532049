"""Payloads, and the numbers that tie an edge node's messages together: state alone, no broker."""

import math
from datetime import UTC, datetime

import pytest

from valvemap.sparkplug.edge_node import Change, EdgeNode
from valvemap.sparkplug.metrics import Quality, Tag, Value, flag_in
from valvemap.sparkplug.schema import DataType, DecodeError, Payload

NOW = 1_790_000_000_000_000_000
NOT_GOOD = 0x4000_0000


def tag(name="Auto/Residual", kind=DataType.DOUBLE, device="V1", alias=7):
    return Tag(f"{device}.{name}", device, name, kind, alias)


def read(message):
    return Payload.FromString(message.payload)


def by_name(message):
    return {metric.name: metric for metric in read(message).metrics}


def properties(metric):
    return {
        key: value.int_value
        for key, value in zip(metric.properties.keys, metric.properties.values, strict=True)
    }


def one(value, kind=DataType.DOUBLE, *, born=0, number=1):
    """The metric as it is in the data of one change."""
    (message,) = EdgeNode("G", "N").data([Change(tag(kind=kind), value, number)], born, NOW)
    (metric,) = read(message).metrics
    return metric


def test_every_connection_takes_the_next_bdseq_and_its_birth_says_the_same():
    node = EdgeNode("G", "N")
    for expected in (*range(256), 0, 1):
        will = node.will(NOW)
        assert (will.topic, will.qos) == ("spBv1.0/G/NDEATH/N", 1)
        assert by_name(will)["bdSeq"].long_value == expected
        (birth,) = node.births({None: ()}, {}, NOW)
        assert by_name(birth)["bdSeq"].long_value == expected


def test_a_death_has_bdseq_alone_and_no_seq():
    node = EdgeNode("G", "N")
    will, death = read(node.will(NOW)), read(node.death(NOW))
    for payload in (will, death):
        assert not payload.HasField("seq")
        assert [metric.name for metric in payload.metrics] == ["bdSeq"]
        assert payload.metrics[0].datatype == DataType.INT64


def test_seq_begins_with_zero_at_a_birth_and_counts_every_message_of_node_and_devices():
    node = EdgeNode("G", "N")
    node.will(NOW)
    births = node.births({None: [], "V1": [tag()], "V2": []}, {}, NOW)
    messages = [*births, node.device_death("V2", NOW)]
    changes = [Change(tag(), Value(1.0, 0, NOW), 1)]
    for _ in range(300):
        messages += node.data(changes, 0, NOW)
    assert [read(message).seq for message in messages] == [k % 256 for k in range(304)]
    again = node.births({None: [], "V1": []}, {}, NOW)
    assert [read(message).seq for message in again] == [0, 1]


def test_births_name_every_metric_with_alias_kind_time_and_value():
    node = EdgeNode("G", "N")
    node.will(NOW)
    own = Tag("Service.Checkpoint.Size", None, "Service/Checkpoint/Size", DataType.UINT64, 1)
    newest = {own.id: Value(2**63, 0, NOW), tag().id: Value(-0.5, 0, NOW)}
    of_node, of_device = node.births({None: [own], "V1": [tag()]}, newest, NOW)
    assert of_node.topic == "spBv1.0/G/NBIRTH/N"
    assert of_device.topic == "spBv1.0/G/DBIRTH/N/V1"
    rebirth = by_name(of_node)["Node Control/Rebirth"]
    assert (rebirth.datatype, rebirth.boolean_value) == (DataType.BOOLEAN, False)
    assert not rebirth.HasField("alias")
    size = by_name(of_node)["Service/Checkpoint/Size"]
    assert (size.alias, size.datatype, size.long_value) == (1, DataType.UINT64, 2**63)
    residual = by_name(of_device)["Auto/Residual"]
    assert (residual.alias, residual.datatype, residual.double_value) == (7, 10, -0.5)
    assert residual.timestamp == NOW // 10**6
    assert properties(residual) == {"Quality": Quality.GOOD}


def test_a_metric_that_nobody_read_yet_is_null_and_stale_in_its_birth():
    node = EdgeNode("G", "N")
    _, born = node.births({None: [], "V1": [tag()]}, {}, NOW)
    metric = by_name(born)["Auto/Residual"]
    assert metric.is_null
    assert properties(metric)["Quality"] == Quality.STALE


def test_data_have_the_alias_and_no_name():
    metric = one(Value(1.5, 0, NOW))
    assert (metric.alias, metric.double_value, metric.HasField("name")) == (7, 1.5, False)
    assert not metric.HasField("is_historical")


def test_what_came_before_a_birth_is_historical_behind_it():
    assert one(Value(1.5, 0, NOW), born=3, number=3).is_historical
    assert not one(Value(1.5, 0, NOW), born=3, number=4).is_historical


@pytest.mark.parametrize(
    ("code", "quality", "is_null"),
    [(0, Quality.GOOD, False), (NOT_GOOD, Quality.STALE, False), (0x8031_0000, Quality.BAD, True)],
)
def test_uncertain_is_stale_and_bad_has_no_value_and_both_keep_their_status(code, quality, is_null):
    metric = one(Value(1.5, code, NOW))
    assert properties(metric)["Quality"] == quality
    assert properties(metric).get("StatusCode", 0) == code
    assert metric.is_null == is_null
    assert metric.HasField("double_value") != is_null


def test_what_is_no_number_is_null_and_an_infinite_one_stays():
    assert one(Value(math.nan, 0, NOW)).is_null
    assert one(Value(math.inf, 0, NOW)).double_value == math.inf


@pytest.mark.parametrize(
    ("kind", "value", "field", "expected"),
    [
        (DataType.INT32, -2, "int_value", 2**32 - 2),
        (DataType.UINT16, 700, "int_value", 700),
        (DataType.INT64, -1, "long_value", 2**64 - 1),
        (DataType.BOOLEAN, False, "boolean_value", False),
        (DataType.STRING, "Öl: −3 K", "string_value", "Öl: −3 K"),
        (DataType.DATE_TIME, datetime(2026, 1, 1, tzinfo=UTC), "long_value", 1_767_225_600_000),
        (DataType.FLOAT, 0.5, "float_value", 0.5),
    ],
)
def test_each_kind_goes_into_its_field(kind, value, field, expected):
    metric = one(Value(value, 0, NOW), kind)
    assert metric.WhichOneof("value") == field
    assert getattr(metric, field) == expected
    assert not metric.is_null


def test_a_time_that_never_was_is_null():
    assert one(Value(datetime(1601, 1, 1, tzinfo=UTC), 0, NOW), DataType.DATE_TIME).is_null


def test_changes_of_a_device_stay_in_their_order_over_several_messages():
    changes = [Change(tag(), Value(float(k), 0, NOW + k), k + 1) for k in range(1_201)]
    messages = list(EdgeNode("G", "N").data(changes, 0, NOW))
    assert {message.topic for message in messages} == {"spBv1.0/G/DDATA/N/V1"}
    values = [metric.double_value for message in messages for metric in read(message).metrics]
    assert values == [float(k) for k in range(1_201)]


def test_a_command_asks_for_births_by_name_and_only_if_it_is_true():
    def command(name, value):
        payload = Payload()
        payload.metrics.add(name=name, boolean_value=value)
        return payload.SerializeToString()

    assert flag_in(command("Node Control/Rebirth", True), "Node Control/Rebirth")  # noqa: FBT003
    assert not flag_in(command("Node Control/Rebirth", False), "Node Control/Rebirth")  # noqa: FBT003
    assert not flag_in(command("Node Control/Reboot", True), "Node Control/Rebirth")  # noqa: FBT003
    with pytest.raises(DecodeError):
        flag_in(b"\xff\xff\xff", "Node Control/Rebirth")
