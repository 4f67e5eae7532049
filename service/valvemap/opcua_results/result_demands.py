"""The demands on the inverse maps: flow and pressure drop, as written by a client."""

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from functools import partial
from inspect import isawaitable

import numpy as np

from valvemap.errors import CommandRejected
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.information_model import INVERSE
from valvemap.opcua_results.result_notes import ResultNotes
from valvemap.pipeline.operator_ports import Answer, Command, Operator

_NOTHING = (np.nan, np.nan)


class ResultDemands:
    """Forwards demands to the operator and stores accepted ones, to repeat them to a successor.

    Parameters
    ----------
    operator
        Accepts demands of a valve, in l/min at bar; NaN withdraws one.
    notes
        Record the demands.
    valves
        Names of the valves that are shown.
    """

    def __init__(self, operator: Operator, notes: ResultNotes, valves: Iterable[str]) -> None:
        self._operator = operator
        self._notes = notes
        self._standing = dict.fromkeys(valves, _NOTHING)  # l/min, bar

    def flow(self, valve: str, Q: float) -> Answer[None]:
        """Demand another flow (l/min) at the current pressure drop."""
        return self._demand(valve, Q, self._standing[valve][1])

    def pressure_drop(self, valve: str, dp: float) -> Answer[None]:
        """Demand the current flow at another pressure drop (bar)."""
        return self._demand(valve, self._standing[valve][0], dp)

    def stand(self, demands: Mapping[str, tuple[float, float]]) -> None:
        """Take these demands as the standing ones of their valves."""
        self._standing |= {name: of for name, of in demands.items() if name in self._standing}

    def follow(self, valves: Iterable[str], gone: Collection[str]) -> None:
        """Switch to other valves; added valves start without a demand."""
        before = {name: of for name, of in self._standing.items() if name not in gone}
        self._standing = {name: before.get(name, _NOTHING) for name in valves}

    async def repeat(self) -> None:
        """Repeat all demands to the new operator; demands that it rejects are ignored."""
        for name, (Q, dp) in self._standing.items():
            if not np.isnan(Q):
                with suppress(CommandRejected):
                    outcome = self._operator.do(Command("demand", name, values=(Q, dp)))
                    if isawaitable(outcome):
                        await outcome

    def _demand(self, valve: str, Q: float, dp: float) -> Answer[None]:
        def demanded(_: None) -> None:
            if valve in self._standing:  # it may have been removed in the meantime
                self._standing[valve] = (Q, dp)
            self._notes.acted(valve, f"{INVERSE} demand {Q:g} l/min at {dp:g} bar")

        command = Command("demand", valve, values=(Q, dp))
        return answered(partial(self._operator.do, command), demanded)
