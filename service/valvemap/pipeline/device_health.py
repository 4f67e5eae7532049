"""A device's health from its alarms, by the categories of NAMUR NE 107. Pure.

The values are those of Devices' DeviceHealthEnumeration (OPC 10000-100, 4.5.4).

==========================  ====================================================================
FAILURE                     unusable output: SensorLost, SensorFrozen, LaneFailed; of an axis:
                            AxisSilent, AxisFailed
OFF_SPEC                    deviation from the map, or extrapolation: Residual, Misfit,
                            Extrapolated; of an axis: AxisMisfit; of the service: Load
MAINTENANCE_REQUIRED        works, but needs inspection: Changed, LagFound, SamplesLost; of an
                            axis: EdgeChanged, LeakageChanged, AirChanged,
                            FrictionChanged;
                            of the service: Checkpoint, Certificate, History, MessagesRejected
NORMAL                      none of these; Unexcited only means that a machine is at rest
CHECK_FUNCTION              never: the service is not informed of work on a device
==========================  ====================================================================
"""

from collections.abc import Iterable

from valvemap.vocabulary.health import DeviceHealth

__all__ = ["HEALTH_OF", "DeviceHealth", "device_health"]

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
    "History": DeviceHealth.MAINTENANCE_REQUIRED,
    "EdgeChanged": DeviceHealth.MAINTENANCE_REQUIRED,
    "LeakageChanged": DeviceHealth.MAINTENANCE_REQUIRED,
    "AirChanged": DeviceHealth.MAINTENANCE_REQUIRED,
    "FrictionChanged": DeviceHealth.MAINTENANCE_REQUIRED,
    "AxisMisfit": DeviceHealth.OFF_SPEC,
    "AxisSilent": DeviceHealth.FAILURE,
    "AxisFailed": DeviceHealth.FAILURE,
    "MessagesRejected": DeviceHealth.MAINTENANCE_REQUIRED,
}
_WORST_FIRST = (
    DeviceHealth.FAILURE,
    DeviceHealth.CHECK_FUNCTION,
    DeviceHealth.OFF_SPEC,
    DeviceHealth.MAINTENANCE_REQUIRED,
)


def device_health(active: Iterable[str]) -> DeviceHealth:
    """Return the worst health that the active alarms imply.

    >>> device_health(["Changed", "Residual"]).name
    'OFF_SPEC'
    >>> device_health(["Unexcited"]).name
    'NORMAL'
    """
    found = {HEALTH_OF[name] for name in active}
    return next((health for health in _WORST_FIRST if health in found), DeviceHealth.NORMAL)
