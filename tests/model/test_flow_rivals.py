"""Operators for which each look has little evidence: the sum over looks."""

import numpy as np
import pytest

from benchmarks import directional_plant as plant
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_rivals import Rivals, none
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.samples import Samples

GIVEN = np.zeros(paths.PARAMETERS)


def parameters(**values):
    at = np.zeros(paths.PARAMETERS)
    for name, value in values.items():
        at[getattr(paths, name)] = value
    return at


def edge_at_work(play, seed, seconds=400.0, gain=1.0, start=0.0):
    """Samples of P → B alone, whose spool lags by two thirds of a step."""
    rng = np.random.default_rng(seed)
    U, load = plant.work(seconds, 100.0, rng)
    valve = plant.Valve(play=play, leakage=0.0, gain=dict.fromkeys(plant.GAINS, gain))
    rows = plant.measured(valve, U, load, 100.0, rng)
    used = rows["U"] < 0.0
    used[5:] &= (rows["U"] < 0.0)[:-5]
    t = np.round((start + rows["t"]) * 1e9).astype(np.int64)
    columns = {"U": -rows["U"], "p1": rows["pP"], "p2": rows["pB"], "Q": rows["QB"]}
    return Samples.of(t=t[used], T=rows["T"][used], **{n: x[used] for n, x in columns.items()})


@pytest.mark.parametrize("seed", [3, 8])
def test_a_play_of_one_percent_is_found_in_machine_work(seed):
    samples, flow_map = edge_at_work(1.0, seed), FlowMap()
    state, _ = flow_map.update(flow_map.initial_state(), samples)
    assert flow_map.half_play(state) == pytest.approx(0.5, abs=0.25)


@pytest.mark.parametrize("seed", [3, 8])
def test_no_play_is_found_where_there_is_none(seed):
    samples, flow_map = edge_at_work(0.0, seed), FlowMap()
    state, _ = flow_map.update(flow_map.initial_state(), samples)
    assert flow_map.half_play(state) == 0.0


def changes(flow_map, state):
    found = flow_map.last_change(state)
    return 0 if found is None else found.count


@pytest.mark.parametrize("seed", [1, 8])
def test_a_play_that_is_hardly_seen_yet_is_no_sudden_change(seed):
    samples, flow_map = edge_at_work(1.0, seed, 150.0), FlowMap()
    state, _ = flow_map.update(flow_map.initial_state(), samples)
    assert changes(flow_map, state) == 0


@pytest.mark.parametrize("seed", [8, 16])
def test_a_change_is_found_though_there_may_be_play(seed):
    flow_map = FlowMap()
    state, _ = flow_map.update(flow_map.initial_state(), edge_at_work(1.0, seed, 60.0))
    assert flow_map.half_play(state) == changes(flow_map, state) == 0
    worn = edge_at_work(1.0, 100 + seed, 30.0, gain=0.9, start=60.0)
    state, _ = flow_map.update(state, worn)
    assert changes(flow_map, state) == 1


def test_evidence_of_looks_adds_up_and_fades():
    rivals, play = Rivals(none(), GIVEN), parameters(PLAY=0.5)
    rivals.meet(8.0, play)
    for _ in range(3):
        rivals.weigh([(8.0, play)])
    assert 28.0 < rivals.gain(play, GIVEN) < 32.0
    for _ in range(100):
        rivals.weigh([(0.0, play)])
    assert rivals.gain(play, GIVEN) < 1.0


def test_one_look_does_not_decide_for_later_ones():
    rivals, play = Rivals(none(), GIVEN), parameters(PLAY=0.5)
    rivals.meet(1e6, play)
    rivals.weigh([(1e6, play)])
    assert rivals.best < rules.CLEAR


def test_evidence_against_a_rival_drops_it():
    rivals, lag = Rivals(none(), GIVEN), parameters(LAG_U=0.01)
    rivals.meet(5.0, lag)
    rivals.weigh([(-9.0, lag)])
    assert list(rivals) == []
    assert rivals.gain(lag, GIVEN) == 0.0


def test_a_rival_has_one_operator_more_than_what_is_in_use():
    rivals = Rivals(none(), parameters(LAG_U=0.1))
    rivals.meet(9.0, parameters(PLAY=0.5))
    rivals.meet(9.0, parameters(LAG_U=0.1, PLAY=0.5, DEAD_Q=0.2))
    rivals.meet(9.0, parameters(LAG_U=0.1, NEWS=1.0))
    rivals.meet(9.0, parameters(LAG_U=0.1, NOISE_U=0.2))
    assert list(rivals) == []
    rivals.meet(9.0, parameters(LAG_U=0.1, PLAY=0.5))
    assert len(list(rivals)) == 1


def test_what_hysteresis_a_weak_one_is_is_left_open():
    rivals = Rivals(none(), GIVEN)
    rivals.meet(9.0, parameters(PLAY=0.5))
    rivals.weigh([(9.0, parameters(RELAYS=0.5))])
    assert rivals.gain(parameters(STICK=0.7), GIVEN) > 15.0


def test_the_weakest_rival_makes_room():
    rivals = Rivals(none(), GIVEN)
    for gain, name in ((3.0, "PLAY"), (4.0, "LAG_U"), (5.0, "KNEE"), (2.0, "DEAD_Q")):
        rivals.meet(gain, parameters(**{name: 0.5}))
    assert rivals.gain(parameters(DEAD_Q=0.5), GIVEN) == 0.0
    rivals.meet(6.0, parameters(DEAD_Q=0.5))
    assert rivals.gain(parameters(DEAD_Q=0.5), GIVEN) == pytest.approx(6.0)
    assert rivals.gain(parameters(PLAY=0.5), GIVEN) == 0.0


def test_others_in_use_begin_without_evidence():
    rivals = Rivals(none(), GIVEN)
    rivals.meet(9.0, parameters(PLAY=0.5))
    rivals.forget()
    assert rivals.best == 0.0
