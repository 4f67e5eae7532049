"""Results of alarms: reports, changes, comments."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from valvemap.model.samples import Times


@dataclass(frozen=True)
class AlarmReport:
    """State of one alarm.

    ``since`` is the time of the last activation, ``at`` that of the last activation, deactivation
    or acknowledgement, both UTC ns, 0: never. ``count`` is the number of activations. ``text``
    gives the measured value, its beginning and possible causes. ``confirmed`` is False between
    acknowledgement and confirmation; ``limit`` is the alarm's limit. ``comment``, ``commented_by``
    and ``commented`` are the last comment, its author and its time (UTC ns; 0: none). ``ended`` is
    the time of the last deactivation (UTC ns; 0: active, never, or not known).
    """

    name: str
    active: bool
    acked: bool
    severity: int
    since: int
    at: int
    count: int
    text: str
    confirmed: bool = True
    limit: float = 0.0
    comment: str = ""
    commented_by: str = ""
    commented: int = 0
    ended: int = 0


@dataclass(frozen=True)
class Remark:
    """An operator's comment on an alarm: text, author, time (UTC ns)."""

    text: str
    by: str
    t: int


@dataclass(frozen=True)
class AlarmChange:
    """One change of an alarm, for the history.

    ``owner`` is a valve's name or the service's, ``t`` the time of the change (UTC ns), ``report``
    the state after it.
    """

    owner: str
    t: int
    report: AlarmReport


@dataclass(frozen=True)
class AlarmResults:
    """The alarms of M valves.

    ``version`` (M,) increases with each change of any alarm of a valve; ``reports(m)`` returns the
    state of all alarms of the m-th valve, and must be called before the next update.
    """

    version: Times
    reports: Callable[[int], Sequence[AlarmReport]]
