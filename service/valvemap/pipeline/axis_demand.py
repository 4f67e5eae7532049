"""The signal for a demanded speed of an axis: from its map, at present pressures. Pure."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from valvemap.model.axis import SPOOL_DAMPING
from valvemap.model.axis_basis import leakage_share
from valvemap.model.axis_inverse import invert
from valvemap.model.lead import DemandCourse, led, spool_delay
from valvemap.pipeline.axis_jobs import Known
from valvemap.pipeline.axis_ports import RequiredU
from valvemap.pipeline.feedforward import FeedForward
from valvemap.vocabulary.statuses import DELIVERS, InverseStatus


class AxisDemand:
    """A demanded speed, and the signal that was last required for it.

    Parameters
    ----------
    settings
        Whether the demand is advanced by the spool's lag; None: it is not.
    """

    def __init__(self, settings: FeedForward | None) -> None:
        self._leads = settings is not None and settings.leads
        self._demand, self._course = np.nan, DemandCourse()
        self._held_U = np.nan

    def demand(self, v: float, t: int) -> None:
        """Demand a speed, mm/s, at a time, UTC ns; NaN withdraws the demand."""
        self._demand, self._course = v, self._course.after(t, v)

    def lead_s(self, known: Known | None) -> float:
        """By how much the demand is advanced, s; 0: it is not, or the map has no spool yet."""
        if known is None or not self._leads:
            return 0.0
        return spool_delay(known.map.spool_hz, SPOOL_DAMPING)

    def required(self, known: Known | None, t: int, newest: Sequence[float]) -> RequiredU:
        """Return the signal for the demanded speed at time ``t`` with `answer`'s ``newest``.

        Half the play is added on the side from which U is approached.
        """
        advance = self._course.advance(t, self.lead_s(known))
        found = led(
            lambda v: answer(known, v, newest),
            self._demand,
            advance,
            lambda one: one.status in DELIVERS,
        )
        if not np.isfinite(found.U) or known is None:
            self._held_U = np.nan
            return found
        half = 0.5 * known.table.play_percent
        held = found.U if np.isnan(self._held_U) else self._held_U
        self._held_U = float(np.clip(held, found.U - half, found.U + half))
        shift = found.U - self._held_U
        U, lower, upper = (x + shift for x in (found.U, found.lower, found.upper))
        return RequiredU(float(np.clip(U, -100.0, 100.0)), lower, upper, found.status)


def answer(known: Known | None, v: float, newest: Sequence[float]) -> RequiredU:
    """Return the signal for a speed, in the middle of its loop.

    ``newest`` are x (mm), T (°C), pA, pB, pS and pT (bar); x and T may be NaN.
    """
    if known is None:
        return RequiredU()
    x, T, p_A, p_B, p_S, p_T = newest
    place = None if np.isnan(x) else x
    table = known.table
    table = replace(table, leakage=leakage_share(T) * table.leakage)
    found = invert(table, v, p_A, p_B, p_S, p_T, place)
    U, lower, upper = (float(column[0]) for column in (found.U, found.lower, found.upper))
    return RequiredU(U, lower, upper, InverseStatus(int(found.status[0])))
