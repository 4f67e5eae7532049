"""DeviceHealth of valves, axes and service, written on change and only where the node exists."""

from collections.abc import Iterable

from asyncua import ua

from guarded_opcua import Clock, HardenedServer, Variable
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.device_health import DeviceHealth, device_health


class ResultHealth:
    """Publishes DeviceHealth, derived from the active alarms.

    Parameters
    ----------
    server
        The server that shows it.
    clock
        Source time while no alarm has changed.
    """

    def __init__(self, server: HardenedServer, clock: Clock) -> None:
        self._server = server
        self._clock = clock
        self._variables: dict[str, Variable] = {}
        self._shown: dict[str, DeviceHealth] = {}

    def __contains__(self, owner: str) -> bool:
        return owner in self._variables

    def forget(self, owner: str) -> None:
        """Drop an owner whose node was removed."""
        self._variables.pop(owner, None)
        self._shown.pop(owner, None)

    def add(self, owner: str, variable: Variable, reports: Iterable[AlarmReport] | None) -> None:
        """Start to publish an owner's health; ``reports`` is None before its first result."""
        self._variables[owner] = variable
        if reports is not None:
            self.stands(owner, reports)

    def stands(self, owner: str, reports: Iterable[AlarmReport]) -> None:
        """Update an owner's health from the reports of all its alarms."""
        variable = self._variables.get(owner)
        if variable is None:
            return
        every = list(reports)
        health = device_health(report.name for report in every if report.active)
        if health != self._shown.get(owner):
            self._shown[owner] = health
            t = max((report.at for report in every), default=0) or self._clock.now()
            self._server.write([(variable, int(health), ua.StatusCodes.Good, t)])
