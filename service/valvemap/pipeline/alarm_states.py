"""State of alarms: activation, acknowledgement, confirmation and comments. Pure.

An activated alarm is to be acknowledged and then confirmed, whether it is still active or not; the
next activation requires both again (OPC UA Part 9, annex B.1). Only the newest comment is stored.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.alarm_results import AlarmReport, Remark
from valvemap.pipeline.alarm_words import Measured, text_of
from valvemap.pipeline.kernels.alarm_layout import Conditions

MOST_OF_A_REMARK = 200  # characters stored of a comment, and of its author's name


@dataclass(frozen=True)
class AlarmRule:
    """Rule of one alarm.

    Attributes
    ----------
    limit, hysteresis : float
        It is activated above the limit and deactivated below the limit less the hysteresis.
    delay_s : float
        Time for which the limit must be exceeded.
    severity : int
        1 … 1,000 (Part 5, 6.4.2).
    """

    limit: float
    hysteresis: float
    delay_s: float
    severity: int


class AlarmStates:
    """The A alarms of each of M valves, or of the service; updated in place.

    Attributes
    ----------
    conditions
        The state that the kernel updates.
    confirmed
        Number of the last confirmed activation of each alarm (M, A).
    ended
        Time of the last deactivation before an operator's last action (M, A), UTC ns; 0: there was
        none, so ``conditions.at`` is the time of the deactivation.
    """

    def __init__(self, M: int, names: Sequence[str], rules: Sequence[AlarmRule]) -> None:
        self._names = tuple(names)
        self._rules = tuple(rules)
        self.conditions = _nothing_wrong(M, len(self._names))
        self.confirmed = np.zeros((M, len(self._names)), np.int64)
        self.ended = np.zeros((M, len(self._names)), np.int64)
        self._remarks: dict[tuple[int, int], Remark] = {}
        self._quiet: dict[int, AlarmReport] = {}  # of alarms that were never active

    def acknowledge(self, m: int, a: int, remark: Remark) -> bool:
        """Acknowledge an alarm; False if there was nothing to acknowledge."""
        if self.conditions.acked[m, a]:
            return False
        self._note_action(m, a, remark)
        self.conditions.acked[m, a] = True
        return True

    def confirm(self, m: int, a: int, remark: Remark) -> bool:
        """Confirm an alarm; False if there was nothing to confirm."""
        if self._is_confirmed(m, a):
            return False
        self._note_action(m, a, remark)
        self.confirmed[m, a] = self.conditions.came[m, a]
        return True

    def remark(self, m: int, a: int, remark: Remark) -> None:
        """Store a comment on an alarm; an empty one leaves the last."""
        if remark.text:
            text, by = remark.text[:MOST_OF_A_REMARK], remark.by[:MOST_OF_A_REMARK]
            self._remarks[m, a] = Remark(text, by, remark.t)
            self.conditions.version[m] += 1

    def reports(self, m: int, reasons: Sequence[str]) -> tuple[AlarmReport, ...]:
        """Return the state of every alarm of one valve; ``reasons`` are for their texts."""
        came = self.conditions.came[m].tolist()
        return tuple(
            [
                self._report(m, a, reason)
                if came[a] or (m, a) in self._remarks
                else self._silent(a)
                for a, reason in enumerate(reasons)
            ]
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all state except comments, each (M, …), not copied."""
        return {**self.conditions._asdict(), "confirmed": self.confirmed, "ended": self.ended}

    def remarks_to_bytes(self, m: int) -> NDArray[np.uint8]:
        """Pack the comments on one valve's alarms."""
        if not self._remarks:
            return _NO_REMARKS
        said = {
            name: [remark.text, remark.by, remark.t]
            for a, name in enumerate(self._names)
            if (remark := self._remarks.get((m, a))) is not None
        }
        return np.frombuffer(json.dumps(said).encode(), np.uint8)

    def remarks_from_bytes(self, m: int, packed: NDArray[np.uint8]) -> None:
        """Restore the comments.

        Raises
        ------
        StateMismatchError
            if the bytes are not packed comments.
        """
        try:
            said = {
                (m, self._names.index(name)): Remark(
                    str(text)[:MOST_OF_A_REMARK], str(by)[:MOST_OF_A_REMARK], int(t)
                )
                for name, (text, by, t) in json.loads(bytes(packed)).items()
            }
        except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise StateMismatchError(f"not what was said of alarms: {error}") from error
        for a in range(len(self._names)):
            self._remarks.pop((m, a), None)
        self._remarks.update(said)

    def _note_action(self, m: int, a: int, remark: Remark) -> None:
        self.ended[m, a] = self._ended(m, a)
        self.conditions.at[m, a] = max(remark.t, self.conditions.at[m, a])
        self.conditions.version[m] += 1
        self.remark(m, a, remark)

    def _ended(self, m: int, a: int) -> int:
        """Time of the last deactivation, UTC ns; 0 while the alarm is active, or never was."""
        conditions = self.conditions
        if conditions.active[m, a]:
            return 0
        earlier = self.ended[m, a] if conditions.acked[m, a] else 0
        return int(earlier or conditions.at[m, a])

    def _is_confirmed(self, m: int, a: int) -> bool:
        """Whether no confirmation is due: not yet acknowledged, or confirmed already."""
        conditions = self.conditions
        waits = conditions.acked[m, a] and self.confirmed[m, a] < conditions.came[m, a]
        return not waits

    def _silent(self, a: int) -> AlarmReport:
        """Return the report of an alarm that was never active, on any valve."""
        if a not in self._quiet:
            nothing = AlarmStates(1, self._names, self._rules)
            self._quiet[a] = nothing._report(0, a, "")
        return self._quiet[a]

    def _report(self, m: int, a: int, reason: str) -> AlarmReport:
        conditions, rule, since = self.conditions, self._rules[a], int(self.conditions.since[m, a])
        said = self._remarks.get((m, a), _NOTHING_SAID)
        measured = Measured(
            value=float(conditions.value[m, a]),
            limit=rule.limit,
            detail=float(conditions.detail[m, a, 0]),
            causes=tuple(conditions.causes[m, a].tolist()),
            since=since,
            reason=reason,
        )
        return AlarmReport(
            name=self._names[a],
            active=bool(conditions.active[m, a]),
            acked=bool(conditions.acked[m, a]),
            severity=rule.severity,
            since=since,
            at=int(conditions.at[m, a]),
            count=int(conditions.came[m, a]),
            text=text_of(self._names[a], measured),
            confirmed=self._is_confirmed(m, a),
            limit=rule.limit,
            comment=said.text,
            commented_by=said.by,
            commented=said.t,
            ended=self._ended(m, a),
        )


_NOTHING_SAID = Remark("", "", 0)
_NO_REMARKS = np.frombuffer(b"{}", np.uint8)


def _nothing_wrong(M: int, A: int) -> Conditions:
    return Conditions(
        over=np.zeros((M, A), np.int64),
        since=np.zeros((M, A), np.int64),
        at=np.zeros((M, A), np.int64),
        active=np.zeros((M, A), np.bool_),
        acked=np.ones((M, A), np.bool_),
        value=np.zeros((M, A)),
        detail=np.zeros((M, A, 2)),
        causes=np.zeros((M, A, 3), np.uint8),
        came=np.zeros((M, A), np.int64),
        version=np.zeros(M, np.int64),
    )
