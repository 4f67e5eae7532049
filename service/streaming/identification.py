"""The service's model of the world: every valve's state, and what people may do to it.

Both the live service and the replay of recordings go through this one object; it knows neither
time nor network.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from service.errors import CommandRejected
from service.identification.estimator import StateMismatchError, key_of
from service.identification.inversion import Inversion
from service.identification.samples import Floats, Quality, Samples, Status, Trace
from service.identification.survey import Survey
from service.streaming import pipeline
from service.streaming.alignment import Alignment
from service.streaming.data_changes import DataChanges
from service.streaming.pipeline import Forgetful, Lane, ValvePlan, ValveState
from service.streaming.ports import (
    Checkpoint,
    EstimatorDescription,
    ValveDescription,
    ValveResult,
)

SURVEYS_AT_ONCE = 40  # half a millisecond each: a fleet is surveyed in turns


class Identification:
    """All valves of one service; fulfils :class:`service.streaming.ports.Operator`."""

    def __init__(self, plans: Sequence[ValvePlan], alignment: Alignment) -> None:
        self.plans = tuple(plans)
        self._alignment = alignment
        self._waiting = alignment.initial_state()
        self._numbers = {plan.name: number for number, plan in enumerate(self.plans)}
        self._states = [pipeline.start(plan) for plan in self.plans]
        self._maps = [pipeline.inverse_map(*pair) for pair in self._pairs()]
        self._surveys: list[Mapping[str, Survey]] = [{} for _ in self.plans]
        self._next_survey = 0

    def take(self, changes: DataChanges) -> Mapping[int, Samples]:
        """Take data changes in; return the samples they completed, by valve."""
        self._waiting, samples = self._alignment.update(self._waiting, changes)
        for valve, batch in samples.items():
            self.take_samples(valve, batch)
        return samples

    def take_samples(self, valve: int, samples: Samples) -> Mapping[str, Trace]:
        """Take samples of one valve in; return what every estimator said of them."""
        self._states[valve], _, traces = pipeline.advance(
            self.plans[valve], self._states[valve], samples
        )
        return traces

    def lane(self, valve: str, estimator: str) -> Lane:
        """One estimator as it stands."""
        return self._states[self._numbers[valve]].lanes[estimator]

    def state(self, valve: int) -> ValveState:
        """One valve as it stands."""
        return self._states[valve]

    def refresh_maps(self) -> None:
        """Compute the inverse's tables anew, and survey the next maps; results show the newest."""
        self._maps = [pipeline.inverse_map(*pair) for pair in self._pairs()]
        lanes = [(number, name) for number, s in enumerate(self._states) for name in s.lanes]
        for _ in range(min(SURVEYS_AT_ONCE, len(lanes))):
            number, name = lanes[self._next_survey % len(lanes)]
            found = pipeline.survey_of(self.plans[number], self._states[number], name)
            self._surveys[number] = {**self._surveys[number], name: found}
            self._next_survey += 1

    def result(self, valve: int, *, lost: bool = False) -> ValveResult:
        """What is published of one valve; all of it is BAD where its sensors are ``lost``."""
        plan, state = self.plans[valve], self._states[valve]
        estimators = {
            name: replace(pipeline.estimator_result(lane), survey=self._surveys[valve].get(name))
            for name, lane in state.lanes.items()
        }
        inverse = pipeline.inverse_result(plan, state, self._maps[valve])
        if lost:
            estimators = {n: replace(r, quality=Quality.BAD) for n, r in estimators.items()}
            inverse = replace(inverse, quality=Quality.BAD)
        return ValveResult(plan.name, estimators, inverse, self.counters(valve))

    def counters(self, valve: int) -> Mapping[str, int]:
        """What was aligned, lost and rejected of one valve since the start."""
        aligned = self._alignment.counters(self._waiting, valve)
        return {**aligned, **self._states[valve].gate.counters}

    def descriptions(self) -> tuple[ValveDescription, ...]:
        """What a results server must know."""
        return tuple(
            ValveDescription(
                name=plan.name,
                estimators=tuple(
                    EstimatorDescription(
                        name=name,
                        description=_first_line(estimator),
                        parameter_names=estimator.parameter_names,
                        has_forgetting_factor=isinstance(estimator, Forgetful),
                    )
                    for name, estimator in plan.estimators.items()
                ),
                Q_range=(min(plan.map_Q), max(plan.map_Q)),
                dp_range=(0.0, max(plan.map_dp)),
                map_Q=plan.map_Q,
                map_dp=plan.map_dp,
            )
            for plan in self.plans
        )

    def reset(self, valve: str, estimator: str) -> None:
        """Forget all samples; what the operator set stays set."""
        lane = self.lane(valve, estimator)
        fresh = pipeline.fresh_lane(lane.estimator)
        self._put(valve, estimator, replace(fresh, frozen=lane.frozen, lam=lane.lam))

    def freeze(self, valve: str, estimator: str) -> None:
        """Stop adaptation."""
        self._put(valve, estimator, replace(self.lane(valve, estimator), frozen=True))

    def resume(self, valve: str, estimator: str) -> None:
        """Adapt again."""
        self._put(valve, estimator, replace(self.lane(valve, estimator), frozen=False))

    def set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> None:
        """Use another forgetting factor from the next sample on."""
        lane = self.lane(valve, estimator)
        if not 0.0 < lam <= 1.0:
            raise CommandRejected(f"forgetting factor {lam:g}: allowed is 0 < lam <= 1")
        if not isinstance(lane.estimator, Forgetful):
            raise CommandRejected(f"{valve}.{estimator} has no forgetting factor")
        try:
            other = pipeline.with_forgetting(lane, lam)
        except ValueError as error:
            raise CommandRejected(f"{valve}.{estimator}: {error}") from None
        self._put(valve, estimator, other)

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Q (l/min), its standard deviation and the estimator's status at one point."""
        state = self._states[self._numbers[valve]]
        T = state.T if np.isnan(T) else T
        return pipeline.predicted(state.lanes[estimator], U, dp, T)

    def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, float, Status]:
        """Q, the 95 % interval of a new measurement (l/min), and the estimator's status."""
        state = self._states[self._numbers[valve]]
        lane = state.lanes[estimator]
        T = state.T if np.isnan(T) else T
        (Q,), (half,) = pipeline.predicted_measurement(
            lane, *(np.array([x], np.float64) for x in (U, dp, T))
        )
        status = Status.WARMING_UP if lane.status is None else lane.status
        return float(Q), float(Q - half), float(Q + half), status

    def invert(self, valve: str, Q: float, dp: float, T: float) -> Inversion:
        """U for a demanded flow at a pressure drop."""
        number = self._numbers[valve]
        return pipeline.demanded(self.plans[number], self._states[number], Q, dp, T)

    def demand(self, valve: str, Q: float, dp: float) -> None:
        """Set the standing demand; NaN takes it back."""
        number = self._numbers[valve]
        self._states[number] = replace(self._states[number], demand_Q=Q, demand_dp=dp)

    def required_U(self) -> Floats:
        """The answers to the standing demands, one per valve; NaN where there is none."""
        return np.array([pipeline.required(*pair)[0] for pair in self._pairs()])

    def checkpoints(self) -> list[Checkpoint]:
        """Every estimator's state as bytes."""
        return [
            Checkpoint(
                valve=plan.name,
                estimator=name,
                key=key_of(plan.estimators[name]),
                t=lane.t,
                state=pipeline.lane_to_bytes(lane, plan.estimators[name]),
                lam=lane.lam,
                frozen=lane.frozen,
            )
            for plan, state in self._pairs()
            for name, lane in state.lanes.items()
        ]

    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], list[str]]:
        """Take up what was kept, where the configuration still fits.

        Returns
        -------
        restored, refused
            names ``<Valve>.<Estimator>``; what is refused starts afresh.
        """
        restored: list[str] = []
        refused: list[str] = []
        for kept in checkpoints:
            taken = self._restore(kept)
            (restored if taken else refused).append(f"{kept.valve}.{kept.estimator}")
        self.refresh_maps()
        return restored, refused

    def _restore(self, kept: Checkpoint) -> bool:
        number = self._numbers.get(kept.valve)
        if number is None or kept.estimator not in self.plans[number].estimators:
            return False
        configured = self.plans[number].estimators[kept.estimator]
        try:
            lane = pipeline.lane_from_bytes(
                kept.state, configured, kept.lam, frozen=kept.frozen, t=kept.t
            )
        except StateMismatchError:
            return False
        self._put(kept.valve, kept.estimator, lane)
        return True

    def _pairs(self) -> list[tuple[ValvePlan, ValveState]]:
        return list(zip(self.plans, self._states, strict=True))

    def _put(self, valve: str, estimator: str, lane: Lane) -> None:
        number = self._numbers[valve]
        state = self._states[number]
        self._states[number] = replace(state, lanes={**state.lanes, estimator: lane})


def _first_line(thing: object) -> str:
    return (type(thing).__doc__ or type(thing).__name__).strip().splitlines()[0]
