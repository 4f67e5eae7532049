"""Leads of valves' demands by the dynamics found. Pure."""

from collections.abc import Sequence
from dataclasses import replace

from valvemap.model.lead import DemandCourse, lead_in_words, spool_delay
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES
from valvemap.vocabulary.statuses import Status


class DemandLeads:
    """The newest demands of the valves whose feed-forward leads, and their spools' delays.

    Times are those of the valves' newest samples, UTC ns.

    Parameters
    ----------
    plans
        The valves.

    Examples
    --------
    >>> DemandLeads([]).advance(0, 0)
    0.0
    """

    def __init__(self, plans: Sequence[ValvePlan]) -> None:
        self._courses = {
            number: DemandCourse()
            for number, plan in enumerate(plans)
            if plan.feed_forward is not None and plan.feed_forward.leads
        }
        self._delays_s: dict[int, float] = {}

    def note_demand(self, valve: int, t: int, Q: float) -> None:
        """Note that a flow (l/min) is demanded from ``t`` on."""
        if valve in self._courses:
            self._courses[valve] = self._courses[valve].after(t, Q)

    def noted(self, valve: int, found: DynamicsResults) -> DynamicsResults:
        """Note dynamics; return them with a sentence on the lead, where the valve is to lead."""
        if valve not in self._courses:
            return found
        self._delays_s[valve] = delay_s = _delay_s(found)
        return replace(found, sentence=f"{found.sentence} {lead_in_words(delay_s)}")

    def advance(self, valve: int, now: int) -> float:
        """Return by how much a valve's demand will have changed after the spool's delay, l/min."""
        if valve not in self._courses:
            return 0.0
        return self._courses[valve].advance(now, self._delays_s.get(valve, 0.0))


def _delay_s(found: DynamicsResults) -> float:
    """Return the spool's delay, s; 0 unless frequency and damping are determined."""
    known = {
        row.field: quantity.value
        for row, quantity in zip(DYNAMIC_QUANTITIES, found.quantities, strict=True)
        if quantity.status is Status.OK
    }
    if not {"natural_frequency", "damping"} <= known.keys():
        return 0.0
    return spool_delay(known["natural_frequency"], known["damping"], known.get("dead_time", 0.0))
