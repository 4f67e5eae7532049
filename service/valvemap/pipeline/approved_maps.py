"""Baselines: maps that operators approved as those of their valves when new."""

from dataclasses import replace

import numpy as np

from valvemap.errors import CommandRejected
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline import lane_predictions, valve_state
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.baseline import Baseline, Difference, difference
from valvemap.pipeline.dynamics_reference import DynamicsReferences
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.valve_state import Lane
from valvemap.vocabulary.statuses import Status


class ApprovedMaps:
    """The baseline of each valve that has one.

    Parameters
    ----------
    valves
        The valves.
    commands
        Resets a valve's estimators.
    references
        Of the valves' dynamics: those of a new valve, too.

    Attributes
    ----------
    baselines : dict
        Baselines by the valve's number.
    counts : int64
        Number of approvals of each valve, (V,).
    """

    def __init__(
        self, valves: AllValves, commands: EstimatorCommands, references: DynamicsReferences
    ) -> None:
        self._valves = valves
        self._commands = commands
        self._references = references
        self.baselines: dict[int, Baseline] = {}
        self.counts = np.zeros(len(valves.plans), np.int64)
        self._unpacked: tuple[tuple[str, str, str], Lane] | None = None  # of the last question

    def approve(self, valve: str) -> None:
        """Store the estimators' states as the valve's baseline, the map when new.

        The next fit of its dynamics is their reference.

        Raises
        ------
        CommandRejected
            if the status of the inverted estimator is neither OK nor UNEXCITED.
        """
        number = self._valves.numbers[valve]
        name, state = self._valves.inverse(number), self._valves.state(number)
        inverse = state.lanes[name]
        if inverse.status not in (Status.OK, Status.UNEXCITED):
            said = "nothing was learnt yet" if inverse.status is None else inverse.status.sentence
            raise CommandRejected(f"{valve}: the map of {name} is not one to build on: {said}")
        self.counts[number] += 1
        keys, count = self._valves.estimator_keys(number), int(self.counts[number])
        self.baselines[number] = Baseline.of(count, state.t, state.lanes, keys)
        self._references.forget(number)

    def roll_back(self, valve: str) -> None:
        """Restore every estimator's state of the baseline.

        Raises
        ------
        CommandRejected
            if there is none, or an estimator's configuration differs; nothing is changed then.
        """
        baseline, before = self._baseline(valve), {}
        for name, configured in self._valves.plans[self._valves.numbers[valve]].estimators.items():
            try:
                before[name] = baseline.lane(name, configured)
            except StateMismatchError as error:
                raise CommandRejected(f"{valve}.{name}: {error}") from None
        for name, then in before.items():
            now = self._valves.lane(valve, name)
            known = then if now.lam is None else valve_state.with_forgetting(then, now.lam)
            self._valves.put(valve, name, replace(known, frozen=now.frozen, status=None))
        fleet, m = self._valves.named(valve)
        fleet.lanes.start_again(m)

    def replace_valve(self, valve: str) -> None:
        """Note that the valve was replaced: reset its estimators and delete its baseline."""
        number = self._valves.numbers[valve]
        for name in self._valves.plans[number].estimators:
            self._commands.reset(valve, name)
        self.baselines.pop(number, None)
        self._references.forget(number)

    def compare(self, valve: str, estimator: str) -> Difference:
        """Return the difference of an estimator's map from the baseline's.

        Raises
        ------
        CommandRejected
            if there is no such baseline or estimator, or its configuration differs.
        """
        plan, then = self._valves.plans[self._valves.numbers[valve]], self._then(valve, estimator)
        now, T = self._valves.lane(valve, estimator), self._valves.T_or_last(valve, np.nan)
        return difference(plan, now, then, T)

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Return Q (l/min), its standard deviation and status at one point of the approved map.

        Raises
        ------
        CommandRejected
            as :meth:`compare` does.
        """
        then, T = self._then(valve, estimator), self._valves.T_or_last(valve, T)
        Q, std, status = lane_predictions.predicted(then, *np.array([[U], [dp], [T]]))
        return float(Q[0]), float(std[0]), Status(int(status[0]))

    def take_up(self, valve: int, kept: Baseline, *, is_approved: bool) -> None:
        """Restore a stored baseline, or only its number if it was deleted."""
        self.counts[valve] = kept.number
        if is_approved:
            self.baselines[valve] = kept

    def _then(self, valve: str, estimator: str) -> Lane:
        """Return an estimator's approved lane; maps are asked for point by point."""
        baseline, plan = self._baseline(valve), self._valves.plans[self._valves.numbers[valve]]
        key = valve, estimator, baseline.digest
        if self._unpacked is not None and self._unpacked[0] == key:
            return self._unpacked[1]
        if estimator not in plan.estimators:
            raise CommandRejected(f"{valve} has no estimator {estimator!r}")
        try:
            then = baseline.lane(estimator, plan.estimators[estimator])
        except StateMismatchError as error:
            raise CommandRejected(f"{valve}.{estimator}: {error}") from None
        self._unpacked = key, then
        return then

    def _baseline(self, valve: str) -> Baseline:
        found = self.baselines.get(self._valves.numbers[valve])
        if found is None:
            raise CommandRejected(f"{valve} has no baseline: Baseline.Approve makes one")
        return found
