"""How alarms stand, and what people did about them. Pure.

An alarm that came is to be acknowledged (it was seen) and then to be confirmed (it was dealt
with), whether it is still there or not; a new coming begins anew (OPC UA Part 9, annex B.1). Kept
of a remark is the newest.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.alarm_words import Measured, text_of
from valvemap.pipeline.kernels.alarms import Conditions
from valvemap.pipeline.ports import AlarmReport, Remark

MOST_OF_A_REMARK = 200  # characters that are kept of a remark, and of the name of who made it


@dataclass(frozen=True)
class AlarmRule:
    """When an alarm comes and goes.

    Attributes
    ----------
    limit, hysteresis : float
        It comes above the limit and goes below the limit less the hysteresis.
    delay_s : float
        For so long the limit must be exceeded.
    severity : int
        1 … 1,000 (Part 5, 6.4.2).
    """

    limit: float
    hysteresis: float
    delay_s: float
    severity: int


class AlarmStates:
    """The A alarms of each of M valves, or of the service; written in place.

    Attributes
    ----------
    conditions
        How they stand, as the kernel moves them on.
    confirmed
        Up to which of its comings each was confirmed (M, A).
    """

    def __init__(self, M: int, names: Sequence[str], rules: Sequence[AlarmRule]) -> None:
        self._names = tuple(names)
        self._rules = tuple(rules)
        self.conditions = _nothing_wrong(M, len(self._names))
        self.confirmed = np.zeros((M, len(self._names)), np.int64)
        self._remarks: dict[tuple[int, int], Remark] = {}

    def acknowledge(self, m: int, a: int, remark: Remark) -> bool:
        """Note that somebody has seen an alarm; False if there was nothing to acknowledge."""
        if self.conditions.acked[m, a]:
            return False
        self.conditions.acked[m, a] = True
        self._moved(m, a, remark)
        return True

    def confirm(self, m: int, a: int, remark: Remark) -> bool:
        """Note that it was dealt with; False if there was nothing to confirm."""
        if self._is_confirmed(m, a):
            return False
        self.confirmed[m, a] = self.conditions.came[m, a]
        self._moved(m, a, remark)
        return True

    def remark(self, m: int, a: int, remark: Remark) -> None:
        """Note what somebody said of an alarm; nothing said leaves what was."""
        if remark.text:
            text, by = remark.text[:MOST_OF_A_REMARK], remark.by[:MOST_OF_A_REMARK]
            self._remarks[m, a] = Remark(text, by, remark.t)
            self.conditions.version[m] += 1

    def reports(self, m: int, reason: str = "") -> tuple[AlarmReport, ...]:
        """How every alarm of one valve stands, in words; ``reason`` is why a lane stopped."""
        return tuple(self._report(m, a, reason) for a in range(len(self._names)))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All but what people said, each (M, …): the arrays themselves."""
        return {**self.conditions._asdict(), "confirmed": self.confirmed}

    def remarks_to_bytes(self, m: int) -> NDArray[np.uint8]:
        """What people said of one valve's alarms."""
        said = {
            name: [remark.text, remark.by, remark.t]
            for a, name in enumerate(self._names)
            if (remark := self._remarks.get((m, a))) is not None
        }
        return np.frombuffer(json.dumps(said).encode(), np.uint8)

    def remarks_from_bytes(self, m: int, packed: NDArray[np.uint8]) -> None:
        """Take up what people said.

        Raises
        ------
        StateMismatchError
            if it is nothing that was packed here.
        """
        try:
            said = {
                (m, self._names.index(name)): Remark(
                    str(text)[:MOST_OF_A_REMARK], str(by)[:MOST_OF_A_REMARK], int(t)
                )
                for name, (text, by, t) in json.loads(bytes(packed)).items()
            }
        except (ValueError, TypeError, AttributeError) as error:
            raise StateMismatchError(f"not what was said of alarms: {error}") from error
        for a in range(len(self._names)):
            self._remarks.pop((m, a), None)
        self._remarks.update(said)

    def _moved(self, m: int, a: int, remark: Remark) -> None:
        self.conditions.at[m, a] = remark.t
        self.conditions.version[m] += 1
        self.remark(m, a, remark)

    def _is_confirmed(self, m: int, a: int) -> bool:
        """Whether it needs no confirming: not before it was acknowledged, not twice."""
        conditions = self.conditions
        waits = conditions.acked[m, a] and self.confirmed[m, a] < conditions.came[m, a]
        return not waits

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
        )


_NOTHING_SAID = Remark("", "", 0)


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
