"""A valid digest says that something was written, not that it can be: what cannot is refused."""

import io
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.plant import as_changes, plant
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import SlidingWindow
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.pipeline import kept_lanes
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.pipeline.valve_state import ValvePlan

CANNOT_BE = (np.nan, np.inf, -np.inf, -1.0, -1e300, 1e300, 2.0**62, 2.5, 77.0)
KEPT = ("RLS", "window", "RML", "RBF", "Auto", "Diagnostics", "Signals", "Alarms", "Recommended")
TWO = 2


@pytest.fixture(scope="module")
def fresh():
    estimators = {
        "RLS": RecursiveLeastSquares(),
        "window": RecursiveLeastSquares(forgetting=SlidingWindow(30)),
        "RML": MaximumLikelihood(),
        "RBF": RbfNetwork(),
        "Auto": FlowMap(),
    }
    plans = [ValvePlan(name, QualityGate(), estimators, "RLS") for name in ("a", "b")]
    align = Alignment(AlignmentSettings(), (("T",),) * TWO, (False,) * TWO)
    return lambda: Identification(plans, align, Timing(TimingSettings(), (("T",),) * TWO))


def changes(n, first=0):
    """Of two valves; of the last sample only some signals have come."""
    parts = [as_changes(plant(n, seed, first)) for seed in (1, 2)]
    parts = [part[part.item != 5] for part in parts]
    moved = [replace(part, item=part.item + np.int32(6 * v)) for v, part in enumerate(parts)]
    return DataChanges.concatenate([moved[0], moved[1][: len(moved[1]) - 2]])


@pytest.fixture(scope="module")
def kept(fresh):
    learnt = fresh()
    learnt.take(changes(400))
    learnt.do(Command.of("set_forgetting_factor", "a", "RLS", 0.99))
    return learnt.states.kept()


def with_one_changed(state, name, place, number):
    """Bytes of a state with one number of one array changed."""
    record = np.load(io.BytesIO(state), allow_pickle=False)
    array = record[name].copy()
    flat = array.reshape(-1)
    if array.dtype.kind in "iu":
        limits = np.iinfo(array.dtype)
        number = (
            0
            if np.isnan(number)
            else max(min(int(np.clip(number, -9e18, 9e18)), limits.max), limits.min)
        )
    with np.errstate(over="ignore"):
        flat[place % flat.size] = number
    record[name] = array
    buffer = io.BytesIO()
    np.save(buffer, record, allow_pickle=False)
    return buffer.getvalue()


def arrays_of(state):
    record = np.load(io.BytesIO(state), allow_pickle=False)
    return [n for n in record.dtype.names if record[n].size and record[n].dtype.kind in "iuf"]


def known(identification, valve):
    result = identification.results.one(valve)
    return {name: (r.theta.tobytes(), r.t, r.sample_count) for name, r in result.estimators.items()}


def test_what_was_kept_is_taken_up_whole(fresh, kept):
    restored, refused = fresh().restore(kept)
    assert not refused
    assert len(restored) == TWO * len(KEPT)


def odd_plant(seed, n=1500):
    """A valve unlike eq. (7), at any scale, that moves in any way; some numbers are broken."""
    rng = np.random.default_rng(seed)
    t, step = 0.01 * np.arange(n), rng.choice([1, 25, 400])
    if rng.random() < 0.5:
        U, dp = (m + m * rng.random() * np.sin(rng.uniform(0.1, 5) * t) for m in (50.0, 100.0))
    else:
        U, dp = (np.repeat(rng.uniform(0, m, n), step)[:n] for m in (100.0, 200.0))
    bent = np.where(rng.uniform(0, 100) < U, 1.0, rng.uniform(0, 2))
    noise = rng.choice([0.0, 0.3, 30.0]) * rng.normal(size=n)
    Q = rng.choice([0.0, 1e-3, 0.1, 5.0]) * bent * U * np.sqrt(dp) + noise
    Q[rng.integers(0, n, rng.choice([0, n // 50]))] += 1e3 * rng.random()
    Q[n // 2 :] *= rng.choice([1.0, 0.7, -1.0])
    Q[rng.integers(0, n, 2)] = rng.choice([np.nan, np.inf, -1e300, 9e4])
    return replace(plant(n), U=U, p2=200 - dp, Q=Q)


@pytest.mark.parametrize("cases", [3, pytest.param(600, marks=pytest.mark.soak)])
def test_whatever_a_valve_has_learnt_it_takes_up_again(fresh, cases):
    for seed in [35, *range(cases)]:  # 35: P becomes singular
        learnt, changed = fresh(), as_changes(odd_plant(seed))
        for part in range(3):
            learnt.take(changed[part * len(changed) // 3 : (part + 1) * len(changed) // 3])
            assert fresh().restore(learnt.states.kept())[1] == {}, seed


@pytest.mark.parametrize("cases", [12, pytest.param(600, marks=pytest.mark.soak)])
def test_whatever_stands_in_what_was_kept_the_other_valve_goes_on(fresh, kept, cases):
    unharmed = fresh()
    unharmed.restore(kept)
    unharmed.take(changes(50, first=400))
    before = known(unharmed, 1)

    @settings(max_examples=cases)
    @given(st.data())
    def holds(data):
        number = data.draw(st.sampled_from([k for k, c in enumerate(kept) if c.valve == "a"]))
        name = data.draw(st.sampled_from(arrays_of(kept[number].state)))
        place, value = data.draw(st.integers(0, 2**20)), data.draw(st.sampled_from(CANNOT_BE))
        hurt = list(kept)
        state = with_one_changed(kept[number].state, name, place, value)
        hurt[number] = replace(kept[number], state=state)
        again = fresh()
        restored, refused = again.restore(hurt)
        assert set(refused) <= {f"a.{kept[number].estimator}"}
        assert len(restored) + len(refused) == len(kept)
        with np.errstate(all="ignore"):
            again.take(changes(50, first=400))
            again.results.one(0)
        assert known(again, 1) == before

    holds()


@pytest.mark.parametrize("lam", [0.0, -0.5, 1.5, np.nan, np.inf])
def test_a_forgetting_factor_that_is_none_is_refused(fresh, kept, lam):
    hurt = [replace(c, lam=lam) if (c.valve, c.estimator) == ("a", "RLS") else c for c in kept]
    again = fresh()
    _, refused = again.restore(hurt)
    assert list(refused) == ["a.RLS"]
    assert "forgetting factor" in refused["a.RLS"]
    assert again.results.one(0).estimators["RLS"].sample_count == 0
    assert again.results.one(1).estimators["RLS"].sample_count > 0


def of_lane(fresh, kept, change):
    """What becomes of a's RLS if its state is another one."""
    (own,) = (c for c in kept if (c.valve, c.estimator) == ("a", "RLS"))
    configured = RecursiveLeastSquares()
    lane = kept_lanes.lane_from_bytes(own.state, configured, None, frozen=False, t=own.t)
    packed = kept_lanes.lane_to_bytes(change(lane), own.key)
    return fresh().restore([replace(own, state=packed)])


@pytest.mark.parametrize("what", ["theta", "D", "another n", "samples", "no count"])
def test_a_state_that_cannot_have_been_learnt_is_refused(fresh, kept, what):
    def change(lane):
        state = lane.state
        arrays = {f.name: getattr(state, f.name).copy() for f in fields(state)}
        other = replace(state, **arrays)
        match what:
            case "theta":
                other.theta[2] = np.nan
            case "D":
                other.row[other._places.factor + 2] = -1e-9
            case "another n":
                n = len(state.rhs) - 1
                other = replace(other, rhs=state.rhs[:n], R=state.R[:n, :n], row=state.row[:170])
            case "samples":
                other.counters[0] = 2**60
            case _:
                return replace(lane, count=-1)
        return replace(lane, state=other)

    restored, refused = of_lane(fresh, kept, change)
    assert (restored, list(refused)) == ([], ["a.RLS"])


def test_it_is_said_which_valve_starts_afresh_and_why(fresh):
    nobody = Checkpoint("gone", "RLS", "k", 1, b"", lam=None, frozen=False)
    assert fresh().restore([nobody])[1] == {"gone.RLS": "no such valve is configured"}
