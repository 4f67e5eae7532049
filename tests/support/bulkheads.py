"""Eight valves, and an error that is raised in one step of one of them."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from support.plant import plant
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.pipeline import (
    alarms,
    kept_states,
    lanes,
    required_signal,
    result_tables,
    shared_support,
    valve_state,
)
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.runtime import past_pieces
from valvemap.vocabulary.signals import PER_VALVE

VALVES, CULPRIT = 8, 5
LANES = ("RLS", "RML", "RBF")
MARK = 33.125  # °C: the oil of the valve at which something raises


class Recorder:
    """Takes samples for a recording."""

    def take(self, valve, samples):
        pass


class Sink:
    """Notes the sample counts that are published."""

    def __init__(self):
        self.published = []

    async def publish(self, results):
        for m, valve in enumerate(results.valves.tolist()):
            counts = {name: int(r.sample_count[m]) for name, r in results.estimators.items()}
            self.published.append((valve, counts))

    async def doubt(self, valves):
        pass

    async def show_health(self, health):
        pass


def plans():
    estimators = {
        "RLS": RecursiveLeastSquares(),
        "RML": MaximumLikelihood(),
        "RBF": RbfNetwork(),
    }
    return [ValvePlan(f"V{v}", QualityGate(), estimators, "RLS") for v in range(VALVES)]


def signals(valve, number):
    """A batch of 20 samples of one valve; the culprit's oil temperature marks it."""
    samples = plant(20, seed=100 * valve + number, first=20 * number)
    samples.T[:] = MARK if valve == CULPRIT else 40.0
    return samples


@dataclass(frozen=True)
class Injected:
    """Where an error is raised, which lanes it stops, and what the alarm says of it."""

    name: str
    step: Step
    stops: tuple[str, ...]
    owner: object
    function: str
    is_met: Callable[..., bool]

    @property
    def said(self):
        return f"{'all estimators' if self.stops == LANES else self.stops[0]}, {self.step}"


def broken(patch, step):
    """Have one step raise at the culprit, before or after it has done its work."""
    whole = getattr(step.owner, step.function)

    async def raising_later(*args, **kwargs):
        await whole(*args, **kwargs)
        if step.is_met(*args, **kwargs):
            raise RuntimeError("injected")

    def raising(*args, **kwargs):
        found = whole(*args, **kwargs)
        if step.is_met(*args, **kwargs):
            raise RuntimeError("injected")
        return found

    is_async = inspect.iscoroutinefunction(whole)
    patch.setattr(step.owner, step.function, raising_later if is_async else raising)


def _among(samples, segments):
    rows = [np.arange(*pair) for pair in zip(segments.starts, segments.stops, strict=True)]
    return len(rows) > 0 and bool((samples.T[np.concatenate(rows)] == MARK).any())


def _learning(name, owner):
    return Injected(f"learning {name}", Step.LEARNING, (name,), owner, "update_many", _learns)


def _learns(_estimator, _states, samples, segments):
    return _among(samples, segments)


def _of(plan, *_):
    return plan.name == f"V{CULPRIT}"


STEPS = (
    Injected(
        *("alignment", Step.ALIGNMENT, LANES, Alignment, "take"),
        lambda _alignment, _waiting, changes: CULPRIT in changes.item // PER_VALVE,
    ),
    Injected(
        *("gate", Step.GATE, LANES, QualityGate, "judge"),
        lambda _gate, _state, samples, segments: _among(samples, segments),
    ),
    Injected(
        "learning RLS", Step.LEARNING, ("RLS",), RecursiveLeastSquares, "update_many", _learns
    ),
    _learning("RML", MaximumLikelihood),
    _learning("RBF", RbfNetwork),
    Injected(
        *("outside of any step", Step.LEARNING, LANES, lanes.Lanes, "take"),
        lambda _lanes, samples, segments, _restore, _stop: _among(samples, segments),
    ),
    Injected(
        *("support", Step.SUPPORT, LANES, shared_support.SharedSupport, "learn"),
        lambda _shared, samples, _said, segments: _among(samples, segments),
    ),
    Injected(
        *("alarms", Step.ALARMS, LANES, alarms.Alarms, "watch"),
        lambda _alarms, samples, _trace, segments: _among(samples, segments),
    ),
    Injected(
        *("alarms' losses", Step.ALARMS, LANES, alarms.Alarms, "note_losses"),
        lambda _alarms, chosen, *_: CULPRIT in chosen,
    ),
    Injected(
        *("survey", Step.SURVEY, ("RML",), valve_state, "survey_of"),
        lambda plan, _state, name: _of(plan) and name == "RML",
    ),
    Injected("map", Step.MAP, ("RLS",), required_signal, "inverse_map", _of),
    Injected("inverse", Step.INVERSE, ("RLS",), required_signal, "required", _of),
    Injected(
        *("results", Step.RESULTS, LANES, result_tables.ResultTables, "_of_fleet"),
        lambda _tables, _fleet, valves, *_: CULPRIT in valves,
    ),
    Injected(
        *("history", Step.HISTORY, LANES, past_pieces, "_signals"),
        lambda valve, _samples: valve == f"V{CULPRIT}",
    ),
    Injected(
        *("checkpoint", Step.CHECKPOINT, LANES, kept_states.KeptStates, "_checkpoints_of"),
        lambda _states, valve, _state: valve == CULPRIT,
    ),
    Injected(
        *("recording", Step.RECORDING, LANES, Recorder, "take"),
        lambda _recorder, valve, _samples: valve == f"V{CULPRIT}",
    ),
    Injected(
        *("publication", Step.PUBLICATION, LANES, Sink, "publish"),
        lambda _sink, results: CULPRIT in results.valves,
    ),
)
