"""The alarms of an axis, one row an alarm.

Nodes (`s=<Axis>.Alarms.<label>`), their conditions and the documentation are made from these rows.
A new alarm is a row here, its rule in ``pipeline/axis_alarms.py``, its text in
``pipeline/alarm_words.py``, what to do in ``vocabulary/alarm_guide.py`` and its health in
``pipeline/device_health.py``.
"""

from valvemap.vocabulary.statuses import Described


class AxisAlarm(Described):
    """Alarms of an axis; the label is the name in NodeIds."""

    EDGE_CHANGED = 0, "EdgeChanged", "An edge of the axis' valve passes another flow than it did."
    LEAKAGE_CHANGED = 1, "LeakageChanged", "More or less oil leaks between the lines than did."
    AIR_CHANGED = 2, "AirChanged", "Oil and hoses are softer or stiffer than they were."
    AXIS_MISFIT = (
        3,
        "AxisMisfit",
        "Speeds and pressures no longer fit the edges, and no single cause explains it.",
    )
    AXIS_SILENT = 4, "AxisSilent", "No sample of the axis arrives."
    AXIS_FAILED = 5, "AxisFailed", "The axis stopped at an unexpected error."
    FRICTION_CHANGED = 6, "FrictionChanged", "The piston moves with more or less dry friction."
