"""Health of a device by NAMUR NE 107, as in DeviceHealthEnumeration (OPC 10000-100, 4.5.4)."""

from valvemap.vocabulary.statuses import Described


class DeviceHealth(Described):
    """Health of a device.

    Examples
    --------
    >>> DeviceHealth.OFF_SPEC.label
    'out of specification'
    """

    NORMAL = 0, "normal", "No alarm says otherwise."
    FAILURE = 1, "failure", "The output cannot be used."
    CHECK_FUNCTION = 2, "function check", "The device is being serviced."
    OFF_SPEC = 3, "out of specification", "The valve deviates from its map, or extrapolates."
    MAINTENANCE_REQUIRED = 4, "maintenance required", "It works, but needs inspection."
