"""What the attacked server has of alarms and histories: a hundred alarms, three hours at 100 Hz."""

import asyncio
import time
from dataclasses import replace
from functools import partial

import numpy as np
from asyncua import ua

from guarded_opcua import (
    Condition,
    ConditionClass,
    ConditionKey,
    ConditionKind,
    PastEvent,
    Records,
    Span,
)

ALARMS, AT_ONCE = 100, 10
VALUES, STEP, T0 = 1_000_000, 10_000_000, 1_800_000_000_000_000_000  # 100 Hz, ns
EVENTS = 10_000
COMMENT = 200  # characters that are kept of one
SERVER = ua.NodeId(ua.ObjectIds.Server)
TEXT = (
    "The residual is 2.4 times the usual one (limit 2), since 2027-01-15 08:00:03 UTC. It may be: "
)


def condition_id(number: int, index: int = 2) -> ua.NodeId:
    """The ConditionId of an alarm."""
    return ua.NodeId(f"Plant.Alarm{number}.Condition", index)


def alarm(number: int, changed: int = T0) -> Condition:
    """An alarm that has come for the first time."""
    key = ConditionKey(
        id=condition_id(number),
        name=f"Alarm{number}",
        kind=ConditionKind.ABOVE_LIMIT,
        category=ConditionClass.MAINTENANCE,
        source=ua.NodeId("Plant", 2),
        source_name="Plant",
        emitters=(SERVER, ua.NodeId("Plant", 2)),
    )
    return Condition(
        key=key,
        active=True,
        acked=False,
        confirmed=True,
        severity=500,
        message=TEXT + "the valve's edge; the flow meter; p1",
        coming=1,
        changed=changed,
        limit=2.0,
    )


class Alarms:
    """Fulfils :class:`guarded_opcua.ConditionKeeper`."""

    def __init__(self, server) -> None:
        self._server = server
        self._standing = {each.key.id: each for each in map(alarm, range(ALARMS))}
        self._turn = 0

    def change(self) -> None:
        """Change the given ones, one after the other."""
        for k in range(AT_ONCE):
            id_ = condition_id((self._turn + k) % ALARMS)
            self._set(replace(self._standing[id_], changed=time.time_ns()))
        self._turn += AT_ONCE

    def find(self, condition):
        return self._standing.get(condition)

    def retained(self):
        yield list(self._standing.values())

    def acknowledge(self, condition, comment):
        self._set(replace(self._standing[condition], acked=True, confirmed=False))
        self.remark(condition, comment)

    def confirm(self, condition, comment):
        self._set(replace(self._standing[condition], confirmed=True))
        self.remark(condition, comment)

    def remark(self, condition, comment):
        said = {"comment": comment[:COMMENT], "commented": time.time_ns()}
        self._set(replace(self._standing[condition], **said))

    def _set(self, condition):
        self._standing[condition.key.id] = condition
        self._server.conditions.report(condition)


class Past:
    """Fulfils Historian and EventHistorian: a thread answers, as it would from a file."""

    def raw(self, _, span, skip, most):
        return asyncio.to_thread(self._raw, span, skip, most)

    def events(self, _, span, skip, most):
        return asyncio.to_thread(self._events, span, skip, most)

    def _raw(self, span, skip, most):
        chosen = _chosen(span, STEP, VALUES, skip, most)
        t = T0 + STEP * chosen
        return Records(np.sin(0.001 * chosen), np.zeros(len(t), np.uint32), t, t)

    def _events(self, span, skip, most):
        every = 60 * STEP
        chosen = _chosen(span, every, EVENTS, skip, most).tolist()
        return [PastEvent(T0 + every * k, partial(_event, k, T0 + every * k)) for k in chosen]


def _event(k, t):
    return alarm(k % ALARMS, t).event()


def _chosen(span: Span, step, count, skip, most):
    first = min(max(-(-(span.low - T0) // step), 0), count)
    last = min(max((span.high - T0) // step + 1, 0), count)
    every = np.arange(first, max(last, first))
    every = every[::-1] if span.backwards else every
    return every[skip : skip + most]
