"""The maps that people approved as those of their valves when new, and what they do with them."""

from dataclasses import replace

import numpy as np

from valvemap.errors import CommandRejected
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline import valve_state
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.baseline import Baseline, Difference, difference
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.vocabulary.statuses import Status


class ApprovedMaps:
    """The baseline of each valve that has one.

    Parameters
    ----------
    valves
        Whose.
    commands
        By which a valve's estimators forget.

    Attributes
    ----------
    baselines : dict
        By the valve's number.
    counts : int64
        How many were approved of each valve, (V,).
    """

    def __init__(self, valves: AllValves, commands: EstimatorCommands) -> None:
        self._valves = valves
        self._commands = commands
        self.baselines: dict[int, Baseline] = {}
        self.counts = np.zeros(len(valves.plans), np.int64)

    def approve(self, valve: str) -> None:
        """Keep what the estimators know as the valve's map when new.

        Raises
        ------
        CommandRejected
            if nothing to build on was learnt.
        """
        number = self._valves.numbers[valve]
        plan, state = self._valves.plans[number], self._valves.state(number)
        inverse = state.lanes[plan.inverse]
        if inverse.status not in (Status.OK, Status.UNEXCITED):
            said = "nothing was learnt yet" if inverse.status is None else inverse.status.sentence
            raise CommandRejected(
                f"{valve}: the map of {plan.inverse} is not one to build on: {said}"
            )
        self.counts[number] += 1
        keys, count = self._valves.estimator_keys(number), int(self.counts[number])
        self.baselines[number] = Baseline.of(count, state.t, state.lanes, keys)

    def roll_back(self, valve: str) -> None:
        """Have every estimator know what it knew when the baseline was approved.

        Raises
        ------
        CommandRejected
            if there is none, or an estimator is configured otherwise; nothing is changed then.
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
            self._valves.put(valve, name, replace(known, frozen=now.frozen))
        fleet, m = self._valves.named(valve)
        fleet.start_again(m)

    def replace_valve(self, valve: str) -> None:
        """Another valve is there: nothing that was learnt holds, there is no baseline any more."""
        number = self._valves.numbers[valve]
        for name in self._valves.plans[number].estimators:
            self._commands.reset(valve, name)
        self.baselines.pop(number, None)

    def compare(self, valve: str, estimator: str) -> Difference:
        """By how much an estimator's map has moved away from the baseline's.

        Raises
        ------
        CommandRejected
            if there is no such baseline or estimator, or that is configured otherwise.
        """
        baseline, plan = self._baseline(valve), self._valves.plans[self._valves.numbers[valve]]
        if estimator not in plan.estimators:
            raise CommandRejected(f"{valve} has no estimator {estimator!r}")
        try:
            then = baseline.lane(estimator, plan.estimators[estimator])
        except StateMismatchError as error:
            raise CommandRejected(f"{valve}.{estimator}: {error}") from None
        now, T = self._valves.lane(valve, estimator), self._valves.T_or_last(valve, np.nan)
        return difference(plan, now, then, T)

    def of(self, valve: int) -> Baseline | None:
        """The map of a valve that was approved as new, if one was."""
        return self.baselines.get(valve)

    def take_up(self, valve: int, kept: Baseline, *, is_approved: bool) -> None:
        """Go on from a baseline that was kept, or from its number alone where there is none now."""
        self.counts[valve] = kept.number
        if is_approved:
            self.baselines[valve] = kept

    def _baseline(self, valve: str) -> Baseline:
        found = self.of(self._valves.numbers[valve])
        if found is None:
            raise CommandRejected(f"{valve} has no baseline: Baseline.Approve makes one")
        return found
