"""The alarms of all valves and of the service: their state, and operators' actions on them."""

import math
from collections.abc import Mapping

from valvemap.errors import CommandRejected
from valvemap.model.samples import Times
from valvemap.pipeline.alarm_results import AlarmReport, Remark
from valvemap.pipeline.alarm_rules import ALARM_NAMES, Alarm
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.lane_failures import Rows
from valvemap.pipeline.service_alarms import ServiceAlarms
from valvemap.vocabulary.service_alarms import ServiceAlarm

OF_SERVICE = "Service"  # owner of the service's alarms; no valve has this name


class AllAlarms:
    """Forwards operators' actions to the alarms of a valve, by its name, or (None) of the service.

    Parameters
    ----------
    valves
        The valves, whose fleets judge their alarms.
    rules
        Rules of the service's alarms.

    Attributes
    ----------
    of_service : ServiceAlarms
    """

    def __init__(self, valves: AllValves, rules: Mapping[ServiceAlarm, AlarmRule]) -> None:
        self._valves = valves
        self.of_service = ServiceAlarms(rules)

    def acknowledge(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Acknowledge an alarm.

        Raises
        ------
        CommandRejected
            if there is nothing to acknowledge.
        """
        if valve is None:
            taken = self.of_service.acknowledge(alarm, remark)
        else:
            fleet, m = self._valves.named(valve)
            taken = fleet.alarms.acknowledge(m, _of_valve(alarm), remark)
        if not taken:
            raise CommandRejected(f"{valve or OF_SERVICE}.{alarm}: there is nothing to acknowledge")

    def confirm(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Confirm an acknowledged alarm.

        Raises
        ------
        CommandRejected
            if there is nothing to confirm.
        """
        if valve is None:
            taken = self.of_service.confirm(alarm, remark)
        else:
            fleet, m = self._valves.named(valve)
            taken = fleet.alarms.states.confirm(m, _of_valve(alarm), remark)
        if not taken:
            raise CommandRejected(f"{valve or OF_SERVICE}.{alarm}: there is nothing to confirm")

    def remark(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Store an operator's comment on an alarm."""
        if valve is None:
            self.of_service.remark(alarm, remark)
        else:
            fleet, m = self._valves.named(valve)
            fleet.alarms.states.remark(m, _of_valve(alarm), remark)

    def alarmed(self) -> list[str]:
        """Return the valves that have ever had an active alarm."""
        versions = [fleet.alarms.version for fleet in self._valves.fleets]
        kind, places = self._valves.kind, self._valves.places
        return [
            plan.name
            for valve, plan in enumerate(self._valves.plans)
            if versions[kind(valve)][places[valve]]
        ]

    def reports(self, valve: str | None) -> tuple[AlarmReport, ...]:
        """Return the state of all alarms of a valve or (None) of the service."""
        if valve is None:
            return self.of_service.reports()
        fleet, m = self._valves.named(valve)
        return fleet.alarms.reports(m)

    def was_away(self) -> None:
        """Note an outage of the service: silence until now is no loss of the sensors."""
        for fleet in self._valves.fleets:
            fleet.alarms.was_away()

    def say_overdue(self, valves: Times, now: Times) -> list[int]:
        """Note that valves (M,) are silent until ``now`` (M,), UTC ns by their sources' clocks.

        Returns the valves with a newly activated alarm.
        """
        new: list[int] = []
        for fleet, chosen in self._valves.by_fleet(valves):
            own, alarms = valves[chosen], fleet.alarms
            places = self._valves.places[own]
            before = alarms.version[places]

            def watch(
                rows: Rows,
                alarms: Alarms = alarms,
                places: Times = places,
                now: Times = now[chosen],
            ) -> None:
                alarms.overdue(places[rows], now[rows])

            fleet.watch(places, watch)
            new += own[alarms.version[places] != before].tolist()
        return new

    def watch_service(
        self,
        now: int,
        checkpoint_age_s: float,
        days_left: float,
        load: float,
        history_waits_s: float = math.nan,
    ) -> tuple[AlarmReport, ...]:
        """Update the service's alarms: age of the checkpoints, certificate, load, history."""
        self.of_service.note(
            now,
            {
                ServiceAlarm.CHECKPOINT: checkpoint_age_s,
                ServiceAlarm.CERTIFICATE: -days_left,
                ServiceAlarm.LOAD: load,
                ServiceAlarm.HISTORY: history_waits_s,
            },
        )
        return self.of_service.reports()


def _of_valve(alarm: str) -> Alarm:
    return Alarm(ALARM_NAMES.index(alarm))
