"""A device's health from its alarms, by the categories of NAMUR NE 107. Pure.

The values are those of Devices' DeviceHealthEnumeration (OPC 10000-100, 4.5.4).

==========================  ====================================================================
FAILURE                     what it sends cannot be used: SensorLost, SensorFrozen, LaneFailed
OFF_SPEC                    it does not do what is known of it, or where nothing is known:
                            Residual, Misfit, Extrapolated; of the service: Load
MAINTENANCE_REQUIRED        it works, somebody should look at it: Changed, LagFound, SamplesLost;
                            of the service: Checkpoint, Certificate
NORMAL                      nothing of that; Unexcited says that a machine stands, no more
CHECK_FUNCTION              never: nobody tells the service that a device is being worked on
==========================  ====================================================================
"""

from collections.abc import Iterable
from enum import IntEnum


class DeviceHealth(IntEnum):
    """How a device is."""

    NORMAL = 0
    FAILURE = 1
    CHECK_FUNCTION = 2
    OFF_SPEC = 3
    MAINTENANCE_REQUIRED = 4


HEALTH_OF = {
    "SensorLost": DeviceHealth.FAILURE,
    "SensorFrozen": DeviceHealth.FAILURE,
    "LaneFailed": DeviceHealth.FAILURE,
    "Residual": DeviceHealth.OFF_SPEC,
    "Misfit": DeviceHealth.OFF_SPEC,
    "Extrapolated": DeviceHealth.OFF_SPEC,
    "Changed": DeviceHealth.MAINTENANCE_REQUIRED,
    "LagFound": DeviceHealth.MAINTENANCE_REQUIRED,
    "SamplesLost": DeviceHealth.MAINTENANCE_REQUIRED,
    "Unexcited": DeviceHealth.NORMAL,
    "Checkpoint": DeviceHealth.MAINTENANCE_REQUIRED,
    "Certificate": DeviceHealth.MAINTENANCE_REQUIRED,
    "Load": DeviceHealth.OFF_SPEC,
}
_WORST_FIRST = (
    DeviceHealth.FAILURE,
    DeviceHealth.CHECK_FUNCTION,
    DeviceHealth.OFF_SPEC,
    DeviceHealth.MAINTENANCE_REQUIRED,
)


def device_health(active: Iterable[str]) -> DeviceHealth:
    """The worst of what the alarms that are active say.

    >>> device_health(["Changed", "Residual"]).name
    'OFF_SPEC'
    >>> device_health(["Unexcited"]).name
    'NORMAL'
    """
    found = {HEALTH_OF[name] for name in active}
    return next((health for health in _WORST_FIRST if health in found), DeviceHealth.NORMAL)
