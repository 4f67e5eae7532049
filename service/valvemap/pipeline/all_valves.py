"""All valves of one service: their plans, their fleets and their state.

The parts of :class:`~valvemap.pipeline.identification.Identification` share this object.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import key_of
from valvemap.model.samples import Times
from valvemap.model.sensor_accuracy import SensorAccuracy
from valvemap.pipeline import valve_state
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.lane_failures import CopyBuffer, LaneFailures, Step
from valvemap.pipeline.timing import Timing
from valvemap.pipeline.valve_state import AnyEstimator, Lane, ValvePlan, ValveState
from valvemap.vocabulary.signals import SENSORS

R = TypeVar("R")


class AllValves:
    """V valves, grouped into fleets with the same plan.

    A valve is identified by its number, 0 <= number < V, or by its name; its place is its number in
    its fleet.

    Parameters
    ----------
    plans
        Plan of each valve.
    timing
        Timing of their signals, with the deadbands of on-change signals.
    waits
        Names of the estimators that do not run.

    Attributes
    ----------
    numbers : dict
        Numbers of the valves, by name.
    fleets : list of Fleet
    places : int64
        Place of each valve in its fleet, (V,).
    failures : LaneFailures
        Failures of lanes.
    """

    def __init__(
        self, plans: Sequence[ValvePlan], timing: Timing, waits: Collection[str] = ()
    ) -> None:
        self.plans = tuple(plans)
        self.numbers = {plan.name: number for number, plan in enumerate(self.plans)}
        self.failures = LaneFailures()
        self.fleets, self._fleet_of, self.places = _fleets(self.plans, self.failures, waits)
        self._timing = timing
        self._keys = [
            {name: key_of(estimator) for name, estimator in fleet.plan.estimators.items()}
            for fleet in self.fleets
        ]

    def at(self, valve: int) -> tuple[Fleet, int]:
        """Return the fleet of a valve, and its place there."""
        return self.fleets[self._fleet_of[valve]], int(self.places[valve])

    def named(self, valve: str) -> tuple[Fleet, int]:
        """As `at`, by the valve's name."""
        return self.at(self.numbers[valve])

    def kind(self, valve: int) -> int:
        """Return the number of a valve's fleet."""
        return int(self._fleet_of[valve])

    def one_of_each_kind(self) -> list[int]:
        """Return the first valve of each fleet."""
        found: list[int] = np.unique(self._fleet_of, return_index=True)[1].tolist()
        return found

    def by_fleet(self, valves: Times) -> Iterator[tuple[Fleet, NDArray[np.intp]]]:
        """Yield each fleet of the given valves (M,), and which of the M are in it."""
        if len(self.fleets) == 1 and len(valves):
            yield self.fleets[0], np.arange(len(valves))
            return
        fleets = self._fleet_of[valves]
        for number in np.unique(fleets):
            yield self.fleets[number], (fleets == number).nonzero()[0]

    def estimator_keys(self, valve: int) -> dict[str, str]:
        """Hash of the hyper-parameters of each of a valve's estimators, by name."""
        return self._keys[self.kind(valve)]

    def lane(self, valve: str, estimator: str) -> Lane:
        """Return one estimator of one valve."""
        fleet, m = self.named(valve)
        return replace(fleet.lane(m, estimator), accuracy=self.accuracy(self.numbers[valve]))

    def put(self, valve: str, estimator: str, lane: Lane) -> None:
        """Replace a lane, see :meth:`Fleet.put`."""
        fleet, m = self.named(valve)
        fleet.put(m, estimator, lane)

    def state(self, valve: int) -> ValveState:
        """Return the state of one valve."""
        fleet, m = self.at(valve)
        state, accuracy = fleet.state(m), self.accuracy(valve)
        if accuracy == fleet.plan.accuracy:
            return state
        lanes = {n: replace(lane, accuracy=accuracy) for n, lane in state.lanes.items()}
        return replace(state, lanes=lanes)

    def state_of(self, valve: int, estimator: str) -> ValveState:
        """Return the state of one valve with one estimator only: whole states are large."""
        fleet, m = self.at(valve)
        return fleet.state(m, [estimator])

    def inverted(self, valve: int) -> tuple[ValvePlan, ValveState]:
        """Return the plan and the state that a valve's inverse is computed from."""
        name = self.inverse(valve)
        return replace(self.plans[valve], inverse=name), self.state_of(valve, name)

    def inverse(self, valve: int) -> str:
        """Name of the estimator whose map is inverted at a valve."""
        fleet, m = self.at(valve)
        return fleet.maps.inverse(m)

    def accuracy(self, valve: int) -> SensorAccuracy:
        """Return the sensors' accuracy, including the deadbands of on-change signals."""
        stated, found = self.plans[valve].accuracy, self._timing.valves[valve].found
        if found is None or not found.deadband.any():
            return stated
        return stated.beside(*found.deadband[: len(SENSORS)].tolist())

    def runs(self, valve: int, estimator: str) -> bool:
        """Whether a lane is running, i.e. has not stopped at an error."""
        fleet, m = self.at(valve)
        return not fleet.lanes.has_failed(m, estimator)

    def waits(self, valve: int, estimator: str) -> bool:
        """Whether a lane does not run because its kernels are not compiled."""
        fleet, _ = self.at(valve)
        return estimator in fleet.lanes.waits

    def stop(self, valve: int, step: Step, estimator: str | None, error: Exception) -> None:
        """Stop a lane, or (None) all lanes of a valve, because of an error, see `Fleet.stop`."""
        fleet, m = self.at(valve)
        fleet.lanes.stop(estimator, step, m, error)

    @contextmanager
    def bulkhead(self, valve: int, step: Step, estimator: str | None = None) -> Iterator[None]:
        """Stop a lane, or (None) all lanes of the valve, if the body raises; suppress the error."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - a bulkhead: the other lanes must not notice
            self.stop(valve, step, estimator, error)

    def T_or_last(self, valve: str, T: float) -> float:
        """Return ``T``, °C, or, if it is NaN, the last temperature measured at a valve."""
        fleet, m = self.named(valve)
        return float(fleet.inputs.T[m]) if np.isnan(T) else T


def once_each(of: Callable[[AnyEstimator], R]) -> Callable[[AnyEstimator], R]:
    """Cache ``of`` by estimator: valves with the same plan share theirs."""
    known: dict[int, R] = {}

    def cached(estimator: AnyEstimator) -> R:
        if id(estimator) not in known:
            known[id(estimator)] = of(estimator)
        return known[id(estimator)]

    return cached


def _fleets(
    plans: Sequence[ValvePlan], failures: LaneFailures, waits: Collection[str]
) -> tuple[list[Fleet], Times, Times]:
    """Return the fleets of valves with the same plan, and each valve's fleet and place."""
    numbers: dict[str, int] = {}
    first: list[ValvePlan] = []
    names: list[list[str]] = []
    places = np.zeros((2, len(plans)), np.int64)
    keys = once_each(key_of)
    for valve, plan in enumerate(plans):
        estimators = [(name, keys(e)) for name, e in plan.estimators.items()]
        ranges = valve_state.nothing_seen(plan).ranges.tolist()
        watched = plan.inverse, plan.follows, plan.references, sorted(plan.alarms.items())
        key = repr((plan.gate, estimators, ranges, plan.accuracy, watched))
        number = numbers.setdefault(key, len(numbers))
        if number == len(first):
            first.append(plan)
            names.append([])
        places[:, valve] = number, len(names[number])
        names[number].append(plan.name)
    buffer = CopyBuffer()
    fleets = [
        Fleet(plan, len(own), own, failures, waits, buffer)
        for plan, own in zip(first, names, strict=True)
    ]
    return fleets, places[0], places[1]
