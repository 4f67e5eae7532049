"""Definitions and instances of templates in births and data: state alone, no broker."""

import pytest

from valvemap.sparkplug.edge_node import Change, EdgeNode
from valvemap.sparkplug.metrics import Meaning, Quality, Tag, Value
from valvemap.sparkplug.schema import DataType, Payload
from valvemap.sparkplug.templates import Templates

NOW = 1_790_000_000_000_000_000
FLOW = Meaning("l/min", (0.0, 200.0), "Flow of the newest sample.")


def tags(device, first=1, *, names=("Signals/Q", "Auto/Structure"), meaning=FLOW):
    kinds = [DataType.DOUBLE, DataType.STRING, DataType.BOOLEAN]
    meanings = [meaning, Meaning(), Meaning()]
    return [
        Tag(f"{device}.{name}", device, name, kind, first + k, of)
        for k, (name, kind, of) in enumerate(zip(names, kinds, meanings, strict=False))
    ]


def born(of, newest=None):
    """NBIRTH and DBIRTHs as payloads, and the node."""
    node = EdgeNode("G", "N", Templates())
    node.will(NOW)
    births = node.births({None: [], **of}, newest or {}, NOW)
    return node, [Payload.FromString(message.payload) for message in births]


def definitions(birth):
    return {m.name: m.template_value for m in birth.metrics if m.datatype == DataType.TEMPLATE}


def said(metric):
    return {
        key: value.string_value or value.double_value or value.int_value
        for key, value in zip(metric.properties.keys, metric.properties.values, strict=True)
    }


def test_valves_with_equal_metrics_share_a_definition_and_others_have_their_own():
    more = ("Signals/Q", "Auto/Structure", "Auto/Frozen")
    of = {"V1": tags("V1"), "V2": tags("V2", 10), "V3": tags("V3", 20, names=more)}
    _, (node, *devices) = born(of)
    found = definitions(node)
    assert len(found) == 2
    for template in found.values():
        assert (template.is_definition, template.HasField("template_ref")) == (True, False)
        assert all(m.is_null and m.HasField("datatype") for m in template.metrics)
        assert not any(m.HasField("alias") for m in template.metrics)
    refs = [device.metrics[0].template_value.template_ref for device in devices]
    assert refs[0] == refs[1] != refs[2]
    assert set(refs) == set(found)


def test_an_instance_has_every_member_of_its_definition_with_value_alias_and_range():
    newest = {"V1.Signals/Q": Value(60.0, 0, NOW)}
    _, (node, device) = born({"V1": tags("V1")}, newest)
    (instance,) = device.metrics
    (definition,) = definitions(node).values()
    assert (instance.name, instance.datatype) == ("Valve", DataType.TEMPLATE)
    assert instance.template_value.is_definition is False
    members = instance.template_value.metrics
    assert [m.name for m in members] == [m.name for m in definition.metrics]
    assert [m.datatype for m in members] == [m.datatype for m in definition.metrics]
    flow, structure = members
    assert (flow.double_value, flow.alias) == (60.0, 1)
    assert said(flow) == {"Quality": 192, "engUnit": "l/min", "engLow": 0.0, "engHigh": 200.0}
    assert structure.is_null
    assert said(structure)["Quality"] == Quality.STALE
    described = {"engUnit": "l/min", "documentation": "Flow of the newest sample."}
    assert said(definition.metrics[0]) == described


def test_aliases_of_an_edge_node_are_unique_and_stay_over_births():
    of = {"V1": tags("V1"), "V2": tags("V2", 10)}
    node, (_, *devices) = born(of)
    used = [d.metrics[0].alias for d in devices]
    used += [m.alias for d in devices for m in d.metrics[0].template_value.metrics]
    assert len(set(used)) == len(used) == 6
    again = [Payload.FromString(m.payload) for m in node.births({None: [], **of}, {}, NOW)[1:]]
    assert [d.metrics[0].alias for d in again] == used[:2]


def data(node, changes, before=0):
    return [Payload.FromString(m.payload) for m in node.data(changes, before, NOW)]


def test_data_are_the_changed_members_alone_by_alias():
    of = {"V1": tags("V1")}
    node, (_, birth) = born(of)
    (payload,) = data(node, [Change(of["V1"][0], Value(61.0, 0, NOW), 1)])
    (instance,) = payload.metrics
    assert instance.alias == birth.metrics[0].alias
    assert not instance.HasField("name")
    template = instance.template_value
    assert template.template_ref == birth.metrics[0].template_value.template_ref
    assert (template.HasField("is_definition"), template.is_definition) == (True, False)
    (member,) = template.metrics
    assert (member.alias, member.double_value, member.HasField("name")) == (1, 61.0, False)


def test_a_member_that_changed_twice_is_in_two_instances_and_history_is_apart():
    of = {"V1": tags("V1")}
    node, _ = born(of)
    flow, structure = of["V1"]
    changes = [
        Change(flow, Value(1.0, 0, NOW), 1),
        Change(structure, Value("x", 0, NOW), 2),
        Change(flow, Value(2.0, 0, NOW), 3),
        Change(structure, Value("y", 0, NOW), 4),
    ]
    (payload,) = data(node, changes, before=3)
    assert [m.is_historical for m in payload.metrics] == [True, True, False]
    sizes = [[m.alias for m in one.template_value.metrics] for one in payload.metrics]
    assert sizes == [[1, 2], [1], [2]]


@pytest.mark.parametrize(
    "other",
    [Meaning("bar", (0.0, 200.0), FLOW.description), Meaning("l/min", (0.0, 200.0), "Another.")],
)
def test_another_unit_or_description_is_another_template_and_another_range_is_not(other):
    wide = Meaning("l/min", (-90.0, 90.0), FLOW.description)
    of = {"V1": tags("V1"), "V2": tags("V2", 10, meaning=wide), "V3": tags("V3", 20, meaning=other)}
    _, (node, *devices) = born(of)
    refs = [device.metrics[0].template_value.template_ref for device in devices]
    assert refs[0] == refs[1] != refs[2]
    assert len(definitions(node)) == 2


def test_the_edge_nodes_own_metrics_stay_single():
    own = Tag("Service.Load", None, "Service/Load", DataType.DOUBLE, 90)
    node = EdgeNode("G", "N", Templates())
    birth, _ = node.births({None: [own], "V1": tags("V1")}, {}, NOW)
    assert "Service/Load" in {m.name for m in Payload.FromString(birth.payload).metrics}
    (payload,) = data(node, [Change(own, Value(0.5, 0, NOW), 1)])
    assert payload.metrics[0].double_value == 0.5
