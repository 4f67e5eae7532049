"""Who holds alarms: the operator those of valves and of the service, axes their own."""

from collections.abc import Sequence
from itertools import chain

from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.axis_ports import AxisOperator
from valvemap.pipeline.operator_ports import Answer, Command, Operator


class AlarmOwners:
    """Forwards requests for alarms, by the name of their owner.

    Parameters
    ----------
    operator
        Of the valves and (None) the service.

    Attributes
    ----------
    axes
        Names of the axes.
    """

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        self._of_axes: AxisOperator | None = None
        self.axes: frozenset[str] = frozenset()

    def follow_axes(self, axes: Sequence[str], operator: AxisOperator | None) -> None:
        """Forward to these axes, in place of those before."""
        self.axes, self._of_axes = frozenset(axes), operator

    def alarms(self, owner: str | None) -> Sequence[AlarmReport]:
        """Return the state of all alarms of a valve, an axis, or (None) the service."""
        if self._of_axes is not None and owner in self.axes:
            return self._of_axes.alarms_of(owner)
        return self._operator.alarms(owner)

    def alarmed(self) -> Sequence[str]:
        """Return the owners that have ever had an active alarm, and all axes."""
        return [*chain(self._operator.alarmed(), sorted(self.axes))]

    def do(self, command: Command) -> Answer[None]:
        """Acknowledge, confirm or comment an alarm."""
        if self._of_axes is not None and command.valve in self.axes:
            self._of_axes.act_on_alarm(command)
            return None
        return self._operator.do(command)
