"""What stands at the inverse maps: the flow that a client demands, and at which pressure drop."""

from collections.abc import Collection, Iterable
from contextlib import suppress
from functools import partial
from inspect import isawaitable

import numpy as np

from valvemap.errors import CommandRejected
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.information_model import INVERSE
from valvemap.opcua_results.result_notes import ResultNotes
from valvemap.pipeline.ports import Answer, Operator

_NOTHING = (np.nan, np.nan)


class ResultDemands:
    """Hands demands on, and keeps those that were taken: another operator must know them, too.

    Parameters
    ----------
    operator
        Takes demands: of a valve, in l/min at bar; NaN takes one back.
    notes
        Show what was demanded.
    valves
        Names of those that are shown.
    """

    def __init__(self, operator: Operator, notes: ResultNotes, valves: Iterable[str]) -> None:
        self._operator = operator
        self._notes = notes
        self._standing = dict.fromkeys(valves, _NOTHING)  # l/min, bar

    def flow(self, valve: str, Q: float) -> Answer[None]:
        """Demand another flow (l/min), at the pressure drop that stands."""
        return self._demand(valve, Q, self._standing[valve][1])

    def pressure_drop(self, valve: str, dp: float) -> Answer[None]:
        """Demand the flow that stands at another pressure drop (bar)."""
        return self._demand(valve, self._standing[valve][0], dp)

    def follow(self, valves: Iterable[str], gone: Collection[str]) -> None:
        """Go on with other valves; nothing is demanded of those that came."""
        before = {name: of for name, of in self._standing.items() if name not in gone}
        self._standing = {name: before.get(name, _NOTHING) for name in valves}

    async def repeat(self) -> None:
        """Have another operator know what stands; what it rejects it does not."""
        for name, (Q, dp) in self._standing.items():
            if not np.isnan(Q):
                with suppress(CommandRejected):
                    outcome = self._operator.demand(name, Q, dp)
                    if isawaitable(outcome):
                        await outcome

    def _demand(self, valve: str, Q: float, dp: float) -> Answer[None]:
        def demanded(_: None) -> None:
            if valve in self._standing:  # it may have gone while the answer was on its way
                self._standing[valve] = (Q, dp)
            self._notes.acted(valve, f"{INVERSE} demand {Q:g} l/min at {dp:g} bar")

        return answered(partial(self._operator.demand, valve, Q, dp), demanded)
