"""The history of signals and results, as the guarded server asks for it."""

import asyncio
from collections.abc import Awaitable
from typing import Final

import numpy as np
from asyncua import ua

from service.hardened import Records, Span
from service.streaming.past import ESTIMATED, REQUIRED_U
from service.streaming.ports import SIGNALS, PastStore

_NO_DATA: Final = np.uint32(ua.StatusCodes.BadNoData)
_BAD: Final = 0x8000_0000
_PARTS: Final = {
    "Signals": frozenset(SIGNALS),
    "Inverse": frozenset({REQUIRED_U}),
}


def has_past(id_: str) -> bool:
    """Whether a variable of the results server is one of those that are kept.

    >>> [has_past(id_) for id_ in ("V1.Signals.Q", "V1.RLS.Residual", "V1.RLS.Status")]
    [True, True, False]
    """
    _, _, rest = id_.partition(".")
    part, _, name = rest.partition(".")
    return name in _PARTS.get(part, ESTIMATED)


class ResultsPast:
    """Fulfils :class:`service.hardened.Historian`: the file is read in a thread."""

    def __init__(self, store: PastStore) -> None:
        self._store = store

    def raw(self, variable: ua.NodeId, span: Span, skip: int, most: int) -> Awaitable[Records]:
        """What a variable was, see :class:`service.hardened.Historian`."""
        return asyncio.to_thread(self._read, str(variable.Identifier), span, skip, most)

    def _read(self, id_: str, span: Span, skip: int, most: int) -> Records:
        series, _, column = id_.rpartition(".")
        past = self._store.read(
            series, column, span.low, span.high, backwards=span.backwards, skip=skip, most=most
        )
        missing = np.isnan(past.values) & (past.codes < _BAD)
        codes = np.where(missing, _NO_DATA, past.codes)
        return Records(past.values, codes, past.t, past.t)
