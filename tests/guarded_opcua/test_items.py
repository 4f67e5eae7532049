"""Monitored items and subscriptions without a network, on a clock turned by hand."""

import math
from types import SimpleNamespace

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary
from hypothesis import given
from hypothesis import strategies as st

from guarded_opcua.binary.encoding import instant
from guarded_opcua.binary.index_range import IndexRangeError, parse_index_range, select
from guarded_opcua.ledger import Holding, Ledger
from guarded_opcua.monitoring.data_change import ChangeRule, FilterRefused, change_rule
from guarded_opcua.monitoring.data_item import DataItem
from guarded_opcua.monitoring.parameters import Monitoring

DOUBLE = ua.VariantType.Double
Trigger = ua.DataChangeTrigger
REPORTING, SAMPLING, DISABLED = (
    ua.MonitoringMode.Reporting,
    ua.MonitoringMode.Sampling,
    ua.MonitoringMode.Disabled,
)
OVERFLOW = 0x480


class Watch:
    """Stands for the subscription of an item."""

    def __init__(self, capacity=1_000):
        self.now = 0.0
        self.clock = SimpleNamespace(monotonic=lambda: self.now)
        self.ledger = Ledger(capacity)
        self.holding = Holding(self.ledger)
        self.reports = []
        self.pending = []
        self.triggered = []

    def has_report(self, number):
        self.reports.append(number)

    def has_no_report(self, number):
        self.reports = [other for other in self.reports if other != number]

    def has_pending(self, number):
        self.pending.append(number)

    def trigger(self, number):
        self.triggered.append(number)


def value(number, code=0, t=0):
    variant = ua.Variant() if code & 0x80000000 else ua.Variant(number, DOUBLE)
    return ua.DataValue(variant, ua.StatusCode(code), instant(t), instant(t))


def item(watch, *, rule=None, size=10, oldest=True, interval=0.0, mode=REPORTING, ranges=None):
    monitoring = Monitoring(7, rule or ChangeRule(), size, oldest, interval, 2)
    wanted = ua.ReadValueId(NodeId=ua.NodeId(1), AttributeId=ua.AttributeIds.Value)
    return DataItem(watch, 1, wanted, mode, monitoring, ranges)


def taken(one, most=1_000):
    found = []
    for record in one.take(most):
        assert int.from_bytes(record[:4], "little") == 7
        found.append(ua_binary.struct_from_binary(ua.DataValue, Buffer(record[4:])))
    return found


def numbers(one):
    return [data.Value.Value for data in taken(one)]


def test_a_slow_ramp_passes_an_absolute_deadband_since_the_last_report_counts():
    watch = Watch()
    one = item(watch, rule=ChangeRule(Trigger.StatusValue, 1.0), size=1_000)
    for step in range(13):
        one(0, value(0.25 * step))
    assert numbers(one) == [0.0, 1.25, 2.5]


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=40), st.floats(0.1, 50))
def test_what_a_deadband_holds_back_is_never_further_off_than_the_deadband(signal, deadband):
    one = item(Watch(), rule=ChangeRule(Trigger.StatusValue, deadband))
    shown = None
    for number in signal:
        one(0, value(number))
        shown = (numbers(one) or [shown])[-1]
        assert abs(shown - number) <= deadband


def test_a_deadband_on_an_array_looks_at_each_element():
    rule = ChangeRule(Trigger.StatusValue, 1.0)
    old, near, far = ([0.0, 0.0], [0.9, -0.9], [0.0, 1.1])
    held = ua.DataValue(ua.Variant(old, DOUBLE))
    assert not rule.is_change(held, ua.DataValue(ua.Variant(near, DOUBLE)))
    assert rule.is_change(held, ua.DataValue(ua.Variant(far, DOUBLE)))
    assert rule.is_change(held, ua.DataValue(ua.Variant([0.0], DOUBLE)))


def test_a_change_of_status_always_passes():
    for trigger in Trigger:
        rule = ChangeRule(trigger, 10.0)
        assert rule.is_change(value(1.0), value(1.0, 0x40900000))
        assert rule.is_change(value(1.0), value(1.0, 0x80000000))


def test_a_trigger_on_the_timestamp_reports_a_constant_signal():
    rule = ChangeRule(Trigger.StatusValueTimestamp)
    assert rule.is_change(value(1.0, t=0), value(1.0, t=100))
    assert not rule.is_change(value(1.0, t=100), value(1.0, t=100))
    assert not ChangeRule().is_change(value(1.0, t=0), value(1.0, t=100))


def test_a_trigger_on_the_status_ignores_values():
    assert not ChangeRule(Trigger.Status).is_change(value(1.0), value(2.0))


def test_a_nan_that_stays_is_no_change_and_one_that_comes_or_goes_is():
    for rule in (ChangeRule(), ChangeRule(Trigger.StatusValue, 1.0)):
        assert not rule.is_change(value(math.nan), value(math.nan))
        assert rule.is_change(value(math.nan), value(1.0))
        assert rule.is_change(value(1.0), value(math.nan))


def test_a_percent_deadband_counts_in_the_range_of_the_node():
    wanted = ua.DataChangeFilter(
        Trigger=Trigger.StatusValue, DeadbandType=ua.DeadbandType.Percent, DeadbandValue=10.0
    )
    assert change_rule(wanted, DOUBLE, 250.0).deadband == 25.0


@pytest.mark.parametrize(
    ("kind", "size", "span", "type_", "code"),
    [
        (ua.DeadbandType.Absolute, -1.0, None, DOUBLE, ua.StatusCodes.BadDeadbandFilterInvalid),
        (ua.DeadbandType.Absolute, math.nan, None, DOUBLE, ua.StatusCodes.BadDeadbandFilterInvalid),
        (ua.DeadbandType.Percent, 101.0, 10.0, DOUBLE, ua.StatusCodes.BadDeadbandFilterInvalid),
        (
            ua.DeadbandType.Percent,
            10.0,
            None,
            DOUBLE,
            ua.StatusCodes.BadMonitoredItemFilterUnsupported,
        ),
        (
            ua.DeadbandType.Absolute,
            1.0,
            None,
            ua.VariantType.String,
            ua.StatusCodes.BadFilterNotAllowed,
        ),
        (7, 1.0, 10.0, DOUBLE, ua.StatusCodes.BadDeadbandFilterInvalid),
    ],
)
def test_a_deadband_that_makes_no_sense_is_refused(kind, size, span, type_, code):
    wanted = ua.DataChangeFilter(Trigger=Trigger.StatusValue, DeadbandType=kind, DeadbandValue=size)
    with pytest.raises(FilterRefused) as caught:
        change_rule(wanted, type_, span)
    assert caught.value.code == code


def test_a_full_queue_discards_the_oldest_and_flags_the_value_after_the_gap():
    watch = Watch()
    one = item(watch, size=3)
    for number in range(5):
        one(0, value(float(number)))
    found = taken(one)
    assert [data.Value.Value for data in found] == [2.0, 3.0, 4.0]
    assert [data.StatusCode.value for data in found] == [OVERFLOW, 0, 0]
    assert watch.ledger.lost == 2


def test_a_full_queue_may_discard_the_newest_and_flags_the_last():
    one = item(Watch(), size=3, oldest=False)
    for number in range(5):
        one(0, value(float(number)))
    found = taken(one)
    assert [data.Value.Value for data in found] == [0.0, 1.0, 4.0]
    assert [data.StatusCode.value for data in found] == [0, 0, OVERFLOW]


def test_a_queue_of_one_holds_the_newest_value_without_a_flag():
    watch = Watch()
    one = item(watch, size=1)
    for number in range(5):
        one(0, value(float(number)))
    found = taken(one)
    assert [(data.Value.Value, data.StatusCode.value) for data in found] == [(4.0, 0)]
    assert watch.ledger.lost == 0


def test_an_overflow_keeps_the_severity_of_the_value():
    one = item(Watch(), size=2)
    for number in range(4):
        one(0, value(float(number), 0x40900000))
    assert taken(one)[0].StatusCode.value == 0x40900000 | OVERFLOW


def test_all_queues_together_are_bounded_and_each_item_keeps_its_newest_value():
    watch = Watch(capacity=5)
    many = [item(watch, size=100) for _ in range(3)]
    for number in range(10):
        for one in many:
            one(0, value(float(number)))
    assert watch.ledger.queued <= 5 + len(many)
    assert all(numbers(one)[-1] == 9.0 for one in many)
    assert watch.ledger.queued == 0
    assert watch.ledger.lost == 30 - 5


def test_a_greedy_session_loses_its_own_notifications_and_nobody_elses():
    greedy, modest = Watch(capacity=100), Watch()
    modest.holding = Holding(greedy.ledger)
    greedy.ledger.sessions = 2
    many = [item(greedy, size=1_000) for _ in range(10)]
    one = item(modest, size=1_000)
    for number in range(40):
        for other in many:
            other(0, value(float(number)))
        one(0, value(float(number)))
    assert numbers(one) == [float(number) for number in range(40)]
    assert greedy.holding.queued <= 100


def test_a_sampling_item_queues_and_reports_when_it_may():
    watch = Watch()
    one = item(watch, mode=SAMPLING)
    one(0, value(1.0))
    assert not watch.reports
    one.set_mode(REPORTING)
    assert watch.reports == [1]
    assert numbers(one) == [1.0]


def test_a_disabled_item_neither_samples_nor_keeps():
    watch = Watch()
    one = item(watch)
    one(0, value(1.0))
    assert not one.set_mode(DISABLED)
    one(0, value(2.0))
    assert not len(one)
    assert watch.ledger.queued == 0
    assert one.set_mode(REPORTING)
    one.start(value(2.0))
    assert numbers(one) == [2.0]


def test_a_sampling_interval_lets_one_value_through_per_interval():
    watch = Watch()
    one = item(watch, interval=1.0, size=100)
    for step in range(100):
        watch.now = 0.1 * step
        one(0, value(float(step)))
        one.sample_pending(watch.now)
    assert len(one) == pytest.approx(10, abs=1)


def test_a_signal_of_just_the_sampling_rate_is_not_thinned_out_by_jitter():
    watch = Watch()
    one = item(watch, interval=1.0, size=100)
    for step in range(50):
        watch.now = step + 0.3 * math.sin(7.0 * step)
        one(0, value(float(step)))
    watch.now = 60.0
    one.sample_pending(watch.now)
    assert numbers(one) == [float(step) for step in range(50)]


def test_items_of_one_sampling_interval_take_their_values_at_the_same_moments():
    watch = Watch()
    early, late = item(watch, interval=1.0, size=100), item(watch, interval=1.0, size=100)
    for step in range(100):
        watch.now = 0.1 * step
        for one in (early, late) if step > 4 else (early,):
            one(0, value(float(step)))
            one.sample_pending(watch.now)
    assert numbers(late)[1:] == numbers(early)[1:]


def test_the_last_value_is_reported_in_the_end_even_if_nothing_follows():
    watch = Watch()
    one = item(watch, interval=1.0)
    one(0, value(1.0))
    watch.now = 0.2
    one(0, value(2.0))
    assert watch.pending == [1]
    assert one.sample_pending(0.5)
    watch.now = 1.1
    assert not one.sample_pending(1.1)
    assert numbers(one) == [1.0, 2.0]


def test_a_shorter_queue_loses_its_surplus():
    watch = Watch()
    one = item(watch, size=10)
    for number in range(5):
        one(0, value(float(number)))
    one.modify(Monitoring(7, ChangeRule(), 2, discard_oldest=True, interval_s=0.0, stamps=2))
    assert numbers(one) == [3.0, 4.0]
    assert watch.ledger.queued == 0
    assert watch.ledger.lost == 3


def test_part_of_an_array_is_monitored_alone():
    watch = Watch()
    one = item(watch, ranges=parse_index_range("1:2"))

    def array(*elements):
        return ua.DataValue(ua.Variant(list(elements), DOUBLE, is_array=True), ua.StatusCode())

    one(0, array(0.0, 1.0, 2.0))
    one(0, array(9.0, 1.0, 2.0))
    one(0, array(9.0, 1.0, 3.0))
    one(0, array(9.0))
    first, second, third = taken(one)
    assert first.Value.Value == [1.0, 2.0]
    assert second.Value.Value == [1.0, 3.0]
    assert third.StatusCode.value == ua.StatusCodes.BadIndexRangeNoData


@pytest.mark.parametrize("text", ["", "a", "-1", "3:1", "2:2", "1:", ":2", "1,", "1" * 20, "1 "])
def test_what_is_no_index_range_is_refused(text):
    with pytest.raises(IndexRangeError):
        parse_index_range(text)


def test_an_index_range_cuts_matrices_and_strings():
    matrix = ua.Variant([[1, 2, 3], [4, 5, 6]], ua.VariantType.Int32)
    assert select(matrix, parse_index_range("0:1,1")).Value == [[2], [5]]
    assert select(ua.Variant("valve"), parse_index_range("1:2")).Value == "al"
    assert select(ua.Variant("valve"), parse_index_range("7")) is None
    assert select(ua.Variant(1.0), parse_index_range("0")) is None


def test_a_linked_item_is_triggered():
    watch = Watch()
    one = item(watch)
    one.links.add(9)
    one(0, value(1.0))
    assert watch.triggered == [1]
