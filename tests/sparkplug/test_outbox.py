from hypothesis import given, settings
from hypothesis import strategies as st

from valvemap.sparkplug.metrics import Tag, Value
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.schema import DataType

TAG = Tag("V1.Signals.Q", "V1", "Signals/Q", DataType.DOUBLE, 1)
OTHER = Tag("V2.Signals.Q", "V2", "Signals/Q", DataType.DOUBLE, 2)


def numbers(changes):
    return [change.value.value for change in changes]


def test_what_was_taken_and_not_confirmed_comes_again_in_its_order():
    outbox = Outbox(most=10)
    for k in range(4):
        outbox.put(TAG, Value(k, 0, k))
    assert numbers(outbox.take(2)) == [0, 1]
    outbox.put_back()
    assert numbers(outbox.take(3)) == [0, 1, 2]
    outbox.confirm()
    outbox.put_back()
    assert numbers(outbox.take(3)) == [3]
    assert outbox.lost == 0


def test_what_waits_of_a_metric_that_is_there_no_more_is_lost_and_counted():
    outbox = Outbox(most=10)
    for k, tag in enumerate((TAG, OTHER, TAG)):
        outbox.put(tag, Value(k, 0, k))
    outbox.keep_only([OTHER])
    assert (outbox.lost, numbers(outbox.take(9))) == (2, [1])


@settings(max_examples=50, deadline=None)
@given(st.lists(st.sampled_from(["put", "take", "confirm", "back"]), max_size=200))
def test_every_value_is_confirmed_or_waits_or_is_counted_as_lost(steps):
    outbox, put, confirmed, taken = Outbox(most=7), 0, 0, 0
    for step in steps:
        if step == "put":
            outbox.put(TAG, Value(put, 0, put))
            put += 1
        elif step == "take":
            taken += len(outbox.take(3))
        elif step == "confirm":
            outbox.confirm()
            confirmed, taken = confirmed + taken, 0
        else:
            outbox.put_back()
            taken = 0
        assert len(outbox) <= 7
        assert confirmed + len(outbox) + outbox.lost == put
    assert outbox.newest == put
