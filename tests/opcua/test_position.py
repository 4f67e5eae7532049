import json

import numpy as np
import pytest
from asyncua import ua

from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.monitored_items import Item
from valvemap.opcua_source.position import Mark, position_from_bytes, position_to_bytes

NOW, ITEMS = 1_800_000_000_000_000_000, 6
BINDING = "this source"


@pytest.fixture
def kept():
    created = ua.CreateSubscriptionResult(
        SubscriptionId=7, RevisedPublishingInterval=100.0, RevisedMaxKeepAliveCount=10
    )
    node = MonitoredNode(item=2, node=ua.NodeId("U", 2), label="U")
    mark = Mark(7, 41, np.full(ITEMS, NOW), NOW - 5)
    return json.loads(position_to_bytes(BINDING, mark, created, [Item(node, 3, 600, 9)]))


def read(kept):
    return position_from_bytes(json.dumps(kept).encode(), BINDING, ITEMS, NOW + 1)


def test_what_was_written_is_read(kept):
    found = read(kept)
    assert found.known_to.tolist() == [NOW] * ITEMS
    assert found.started == NOW - 5
    node = MonitoredNode(item=2, node=ua.NodeId("U", 2), label="U")
    left = found.left([node])
    assert (left.next_message, left.items[0].queue_size, left.items[0].handle) == (42, 600, 9)
    assert found.left([]) is None  # the node is gone


def test_a_position_of_before_has_no_start_of_the_source(kept):
    del kept["started"]
    assert read(kept).started == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("number", -1),
        ("message", 0),
        ("message", 2**32),
        ("publishing_interval_ms", 0.0),
        ("publishing_interval_ms", float("nan")),
        ("keep_alive_count", 0),
        ("items", [[ITEMS, 3, 600, 9]]),
        ("items", [[-1, 3, 600, 9]]),
        ("items", [[2, 3, 600, 9], [2, 4, 600, 10]]),
        ("items", [[2, 3, -5, 9]]),
        ("items", [[2, 3]]),
        ("items", None),
    ],
)
def test_a_subscription_that_cannot_be_is_not_believed(kept, name, value):
    kept["subscription"][name] = value
    assert read(kept) is None


@pytest.mark.parametrize(
    "known_to",
    [[NOW] * 5, [NOW] * 5 + [NOW + 10**15], [NOW] * 5 + [2**70], ["x"] * 6, None, [[NOW] * 6]],
)
def test_times_that_cannot_be_are_not_believed(kept, known_to):
    kept["known_to"] = known_to
    assert read(kept) is None


@pytest.mark.parametrize("data", [b"", b"null", b"[]", b"{}", b"\xff", b'{"format": 2}'])
def test_what_is_no_position_is_not_believed(data):
    assert position_from_bytes(data, BINDING, ITEMS, NOW) is None
