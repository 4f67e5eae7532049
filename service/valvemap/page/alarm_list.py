"""Alarms that wait for an operator: active, unacknowledged or unconfirmed; changes of others."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from valvemap.page.judgement import Severity
from valvemap.page.timeline import TimeLine
from valvemap.readings import ConditionChange

MOST_SHOWN = 300
MOST_PAST = 500
SERVICE = "Service"
_BEGINS_A_WORD = re.compile(r"(?<=[a-z])[A-Z]")
_ALARM, _WARNING = 700, 400  # severities of Part 9 from which on


@dataclass
class AlarmList:
    """The present alarms, as the service's events report them.

    Attributes
    ----------
    present
        By source and name.
    revision
        Counts the changes.
    trouble
        Why the alarms are not known; empty if they are.
    """

    present: dict[tuple[str, str], ConditionChange] = field(default_factory=dict)
    revision: int = 0
    trouble: str = "the page has not asked for them yet"

    def forget(self, trouble: str) -> None:
        """Drop all, before the service reports them again."""
        self.present.clear()
        self.trouble = trouble
        self.revision += 1

    def hear(self, changes: Iterable[ConditionChange], time_line: TimeLine, since: int) -> None:
        """Take changes; those after ``since`` (UTC ns) are events of the time line, too."""
        for change in changes:
            self.revision += 1
            key = change.source, change.name
            before = self.present.get(key)
            if change.retain:
                self.present[key] = change
            else:
                self.present.pop(key, None)
            if change.t >= since and (before is None or before.event != change.event):
                valve = "" if change.source == SERVICE else change.source
                severity, text = _event_of(change)
                time_line.add(change.t, valve, "alarm", severity, text)

    def rows(self) -> list[dict[str, Any]]:
        """Return the worst for the browser: active ones first, then by severity and time."""
        worst = sorted(
            self.present.values(), key=lambda c: (c.active, not c.acked, c.severity, c.t)
        )
        return [row_of(change) for change in worst[: -MOST_SHOWN - 1 : -1]]


def row_of(change: ConditionChange) -> dict[str, Any]:
    """Return a change for the browser."""
    return {
        "t": change.t / 1e6,
        "since": (change.turned or change.t) / 1e6,
        "source": change.source,
        "name": change.name,
        "text": change.text,
        "severity": int(severity_of(change.severity)),
        "active": change.active,
        "acked": change.acked,
        "confirmed": change.confirmed,
        "comment": change.comment,
        "user": change.user,
        "event": change.event.hex(),
    }


def severity_of(severity: int) -> Severity:
    """Return the page's severity of one of Part 9, 1 … 1,000.

    >>> severity_of(800).name, severity_of(500).name, severity_of(100).name
    ('ALARM', 'WARNING', 'NOTE')
    """
    if severity >= _ALARM:
        return Severity.ALARM
    return Severity.WARNING if severity >= _WARNING else Severity.NOTE


def _event_of(change: ConditionChange) -> tuple[Severity, str]:
    by = f" by {change.user}" if change.user else ""
    name = _BEGINS_A_WORD.sub(lambda found: f" {found[0].lower()}", change.name)
    if change.active and not change.acked:
        return severity_of(change.severity), f"{name} raised. {change.text}"
    if change.active:
        return Severity.NOTE, f"{name} acknowledged{by}; still active."
    if not change.acked:
        return Severity.NOTE, f"{name} cleared; not acknowledged yet."
    if not change.confirmed:
        return Severity.NOTE, f"{name} acknowledged{by}; to be confirmed."
    return Severity.NOTE, f"{name} cleared and dealt with."
