"""Health by the categories of NAMUR NE 107."""

import pytest

from valvemap.pipeline.alarm_words import ALARM_DESCRIPTIONS
from valvemap.pipeline.device_health import HEALTH_OF, DeviceHealth, device_health


def test_every_alarm_there_is_has_a_category_and_none_says_what_nobody_knows():
    assert HEALTH_OF.keys() == ALARM_DESCRIPTIONS.keys()
    assert DeviceHealth.CHECK_FUNCTION not in HEALTH_OF.values()


@pytest.mark.parametrize(
    ("active", "expected"),
    [
        ((), DeviceHealth.NORMAL),
        (("Unexcited",), DeviceHealth.NORMAL),
        (("Changed", "Unexcited"), DeviceHealth.MAINTENANCE_REQUIRED),
        (("Changed", "Extrapolated"), DeviceHealth.OFF_SPEC),
        (("Residual", "SensorLost", "Changed"), DeviceHealth.FAILURE),
    ],
)
def test_the_worst_of_what_is_active_counts(active, expected):
    assert device_health(active) is expected
    assert device_health(reversed(active)) is expected


def test_the_numbers_are_those_of_devices():
    names = ["NORMAL", "FAILURE", "CHECK_FUNCTION", "OFF_SPEC", "MAINTENANCE_REQUIRED"]
    assert [member.name for member in DeviceHealth] == names
    assert [member.value for member in DeviceHealth] == [0, 1, 2, 3, 4]
