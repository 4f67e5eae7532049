"""The history of signals, results and alarms, in the form the guarded server reads."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Final

import numpy as np
from asyncua import ua

from guarded_opcua import Cells, Event, PastEvent, Records, Span
from valvemap.opcua_results.information_model import DYNAMICS, ROOT
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.store_ports import PastStore
from valvemap.vocabulary.edges import split_id
from valvemap.vocabulary.history_columns import OF_AXES, REQUIRED_U, REQUIRED_U_STATUS, place_of
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES
from valvemap.vocabulary.signals import PUBLISHED

_NO_DATA: Final = np.uint32(ua.StatusCodes.BadNoData)
_BAD: Final = 0x8000_0000
_ESTIMATED: Final = frozenset(quantity.name for quantity in HISTORY_QUANTITIES)
_PARTS: Final = {
    "Signals": frozenset(PUBLISHED),
    "Inverse": frozenset({REQUIRED_U, REQUIRED_U_STATUS}),
    DYNAMICS: frozenset(),
}


def has_past(id_: str) -> bool:
    """Whether the history of a variable of the results server is stored.

    >>> [has_past(id_) for id_ in ("V1.Signals.Q", "V1.RLS.Status", "V1.RLS.Adaptation")]
    [True, True, False]
    >>> [has_past(id_) for id_ in ("Press.Leakage", "Press.Status", "Press.Reason")]
    [True, True, False]
    """
    _, rest = split_id(id_)
    part, dot, name = rest.partition(".")
    if not dot:
        return part in OF_AXES
    return name in _PARTS.get(part, _ESTIMATED)


class ResultsPast:
    """Fulfils :class:`guarded_opcua.Historian` and `Summarising`: the file is read in a thread."""

    def __init__(self, store: PastStore) -> None:
        self._store = store
        self.widths: Sequence[int] = store.widths

    def raw(self, variable: ua.NodeId, span: Span, skip: int, most: int) -> Awaitable[Records]:
        """Past values of a variable, see :class:`guarded_opcua.Historian`."""
        return asyncio.to_thread(self._read, str(variable.Identifier), span, skip, most)

    def _read(self, id_: str, span: Span, skip: int, most: int) -> Records:
        series, column = place_of(id_)
        past = self._store.read(
            series, column, span.low, span.high, backwards=span.backwards, skip=skip, most=most
        )
        missing = np.isnan(past.values) & (past.codes < _BAD)
        codes = np.where(missing, _NO_DATA, past.codes)
        return Records(past.values, codes, past.t, past.t)

    def cells(
        self, variable: ua.NodeId, low: int, high: int, width: int
    ) -> Awaitable[Cells | None]:
        """Summaries of a variable, see :class:`guarded_opcua.Summarising`."""
        return asyncio.to_thread(self._cells, str(variable.Identifier), low, high, width)

    def _cells(self, id_: str, low: int, high: int, width: int) -> Cells | None:
        series, column = place_of(id_)
        found = self._store.cells(series, column, low, high, width)
        if found is None:
            return None
        marks = found.marks
        return Cells(
            width,
            found.t,
            found.rows,
            found.good,
            found.uncertain,
            found.low,
            found.high,
            found.total,
            low_again=(marks & 1) > 0,
            high_again=(marks & 2) > 0,
            low_first=(marks & 4) > 0,
            high_first=(marks & 8) > 0,
            extent=found.extent,
        )


class AlarmsPast:
    """Fulfils :class:`guarded_opcua.EventHistorian`: past changes of alarms, as events.

    ``event_of`` returns the event of an owner's alarm, from its report at that time.
    """

    def __init__(self, store: PastStore, event_of: Callable[[str, AlarmReport], Event]) -> None:
        self._store = store
        self._event_of = event_of

    def events(
        self, emitter: ua.NodeId, span: Span, skip: int, most: int
    ) -> Awaitable[Sequence[PastEvent]]:
        """Past events, see :class:`guarded_opcua.EventHistorian`."""
        of_all = emitter.NamespaceIndex == 0 or emitter.Identifier == ROOT
        owner = None if of_all else str(emitter.Identifier)
        return asyncio.to_thread(self._read, owner, span, skip, most)

    def _read(self, owner: str | None, span: Span, skip: int, most: int) -> list[PastEvent]:
        found = self._store.changes(
            owner, span.low, span.high, backwards=span.backwards, skip=skip, most=most
        )
        return [
            PastEvent(change.t, partial(self._event_of, change.owner, change.report))
            for change in found
        ]
