"""Event log, newest last: state changes of valves, abrupt changes, operators' actions. Bounded."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from valvemap.page.judgement import Reason, Severity

_MOST = 1_000  # events; a page shows the newest few hundred
_HOLDS_S = 2.0  # s; shorter states are ignored: statuses flicker while signals pause


@dataclass(frozen=True)
class Event:
    """One event.

    Attributes
    ----------
    number
        Counts up over all events.
    t
        Time, UTC ns.
    valve
        Name of the valve; empty for the service itself.
    kind
        ``status``, ``change``, ``action`` or ``link``.
    severity
        Severity of the event.
    text
        A sentence.
    """

    number: int
    t: int
    valve: str
    kind: str
    severity: Severity
    text: str


class TimeLine:
    """Events, and the previous state needed to detect them."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=_MOST)
        self._count = 0
        self._standing: dict[str, tuple[Reason, int]] = {}
        self._arising: dict[str, tuple[Reason, int]] = {}
        self._changes: dict[tuple[str, str], int] = {}
        self._actions: dict[str, str] = {}

    def add(self, t: int, valve: str, kind: str, severity: Severity, text: str) -> None:
        """Add one event."""
        self._count += 1
        self._events.append(Event(self._count, t, valve, kind, severity, text))

    def after(self, number: int) -> Sequence[Event]:
        """Return the events with a higher number."""
        return [event for event in self._events if event.number > number]

    def stands(self, valve: str, reason: Reason, now: int) -> tuple[Reason, int]:
        """Update the state of a valve; return the debounced state and its start (UTC ns).

        A new reason becomes the state once it has lasted for two seconds.
        """
        known = self._standing.get(valve)
        if known is None:
            self._standing[valve] = known = (reason, now)
        elif reason == known[0]:
            self._arising.pop(valve, None)
        else:
            arising = self._arising.get(valve)
            if arising is None or arising[0] != reason:
                self._arising[valve] = arising = (reason, now)
            if now - arising[1] >= _HOLDS_S * 1e9:
                self._standing[valve] = known = arising
                del self._arising[valve]
                self.add(arising[1], valve, "status", reason.severity, reason.sentence)
        return known

    def changed(self, valve: str, estimator: str, count: int, t: int, size: float) -> None:
        """Add an event if an estimator's count of abrupt changes rises; ``size`` in l/min."""
        before = self._changes.get((valve, estimator))
        self._changes[valve, estimator] = count
        if before is not None and count > before:
            sign = "+" if size >= 0.0 else "−"
            text = f"{estimator} found an abrupt change: {sign}{abs(size):.1f} l/min."
            self.add(t, valve, "change", Severity.WARNING, text)

    def acted(self, valve: str, text: str, t: int) -> None:
        """Add an event if the last operator action has changed."""
        before = self._actions.get(valve)
        self._actions[valve] = text
        if before is not None and text and text != before:
            self.add(t, valve, "action", Severity.NOTE, text)
