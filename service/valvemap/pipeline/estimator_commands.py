"""Operators' commands on estimators and standing demands, and queries of their maps."""

from dataclasses import replace

import numpy as np

from valvemap.errors import CommandRejected
from valvemap.model.capabilities import Forgetful
from valvemap.model.inversion import Inversion
from valvemap.pipeline import lane_predictions, required_signal, valve_state
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.demand_leads import DemandLeads
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.required_signal import Required
from valvemap.vocabulary.statuses import Status


class EstimatorCommands:
    """Executes commands on estimators and maps, see :class:`.operator_ports.Operator`.

    Parameters
    ----------
    valves
        The valves.
    leads
        By how much their demands are advanced.
    """

    def __init__(self, valves: AllValves, leads: DemandLeads) -> None:
        self._valves = valves
        self._leads = leads

    def reset(self, valve: str, estimator: str) -> None:
        """Reset the estimator; the operator's settings remain. A failed lane resumes."""
        lane = self._valves.lane(valve, estimator)
        fresh = valve_state.fresh_lane(lane.estimator, lane.support.forgotten())
        self._valves.put(valve, estimator, replace(fresh, frozen=lane.frozen, lam=lane.lam))
        fleet, m = self._valves.named(valve)
        fleet.lanes.start_again(m)
        if estimator == fleet.maps.inverse(m):
            fleet.alarms.forget_map(m)
        fleet.maps.reset(m, estimator)

    def freeze(self, valve: str, estimator: str) -> None:
        """Stop adaptation."""
        lane = self._valves.lane(valve, estimator)
        self._valves.put(valve, estimator, replace(lane, frozen=True))

    def resume(self, valve: str, estimator: str) -> None:
        """Resume adaptation."""
        lane = self._valves.lane(valve, estimator)
        self._valves.put(valve, estimator, replace(lane, frozen=False))

    def set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> None:
        """Set the forgetting factor from the next sample on.

        Raises
        ------
        CommandRejected
            if it is out of range, or the estimator has none.
        """
        lane = self._valves.lane(valve, estimator)
        if not isinstance(lane.estimator, Forgetful):
            raise CommandRejected(f"{valve}.{estimator} has no forgetting factor")
        try:
            other = valve_state.with_forgetting(lane, lam)
        except ValueError as error:
            raise CommandRejected(f"{valve}.{estimator}: {error}") from None
        self._valves.put(valve, estimator, other)

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Q (l/min), its standard deviation and status at one point."""
        lane = self._valves.lane(valve, estimator)
        point = (np.array([x], np.float64) for x in (U, dp, self._valves.T_or_last(valve, T)))
        (Q,), (std,), (status,) = lane_predictions.predicted(lane, *point)
        return float(Q), float(std), Status(int(status))

    def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, float, Status]:
        """Q, the 95 % interval of a new measurement (l/min), and status."""
        lane = self._valves.lane(valve, estimator)
        point = (np.array([x], np.float64) for x in (U, dp, self._valves.T_or_last(valve, T)))
        (Q,), (half,), (status,) = lane_predictions.predicted_measurement(lane, *point)
        return float(Q), float(Q - half), float(Q + half), Status(int(status))

    def invert(self, valve: str, Q: float, dp: float, T: float) -> Inversion:
        """U for a demanded flow at a pressure drop."""
        plan, state = self._valves.inverted(self._valves.numbers[valve])
        return required_signal.demanded(plan, state, Q, dp, T)

    def demand(self, valve: str, Q: float, dp: float) -> None:
        """Set the standing demand; NaN withdraws it."""
        fleet, m = self._valves.named(valve)
        fleet.inputs.demand[m] = Q, dp
        self._leads.note_demand(self._valves.numbers[valve], int(fleet.inputs.t[m]), Q)

    def demands(self) -> dict[str, tuple[float, float]]:
        """Return the standing demands by valve: flow, l/min, and pressure drop, bar."""
        found = {}
        for number, plan in enumerate(self._valves.plans):
            fleet, m = self._valves.at(number)
            Q, dp = fleet.inputs.demand[m].tolist()
            if not (np.isnan(Q) and np.isnan(dp)):
                found[plan.name] = Q, dp
        return found

    def required(self, valve: int) -> tuple[Required, Status]:
        """Return the answer to a valve's standing demand, and its estimator's status."""
        inverse = self._valves.inverse(valve)
        if self._valves.runs(valve, inverse):
            with self._valves.bulkhead(valve, Step.INVERSE, inverse):
                plan, state = self._valves.inverted(valve)
                status = state.lanes[plan.inverse].status
                answer = required_signal.required(plan, state, self._leads.advance(valve, state.t))
                return answer, Status.WARMING_UP if status is None else status
        return required_signal.NOTHING_REQUIRED, Status.FAILED
