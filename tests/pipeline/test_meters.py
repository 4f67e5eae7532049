"""Several valves behind one flow meter: each is learnt as if it had a meter of its own."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.shared_meter import VALVES, config_of, errors, flow, work
from support.soaked import soaked
from valvemap.app.build import build_identification, build_plans
from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError
from valvemap.kafka.catalogue import catalogue_of
from valvemap.model.samples import Samples
from valvemap.model.shared_meter import SharedMeter
from valvemap.pipeline.edges import gathered
from valvemap.pipeline.meters import MOST_WAITING, Meters, _Kept
from valvemap.vocabulary.statuses import Quality

SIGMA = 0.4


@pytest.fixture(scope="module")
def rows():
    return work(8, 120.0)


def parts_of(rows, *, shared=True, sigma=SIGMA, seed=2):
    """The samples of all valves, whose Q is the meter's, or each one's own."""
    rng = np.random.default_rng(seed)
    n = len(rows[VALVES[0]]["U"])
    noise = rng.normal(0.0, sigma, (len(VALVES), n))
    total = sum(own["flow"] for own in rows.values()) + noise[0]
    t = 10**18 + np.arange(n) * 10_000_000
    return [
        Samples.of(
            t=t,
            Q=total if shared else own["flow"] + wrong,
            **{k: own[k] for k in ("U", "p1", "p2", "T")},
        )
        for own, wrong in zip(rows.values(), noise, strict=True)
    ]


def learnt(parts, *, shared=True, cuts=(), estimator="Auto"):
    identification = build_identification(config_of(shared=shared, estimator=estimator))
    feed(identification, parts, cuts)
    return identification


def feed(identification, parts, cuts=()):
    for first, last in pairwise([0, *cuts, len(parts[0])]):
        identification.learn(
            gathered({number: own[first:last] for number, own in enumerate(parts)})
        )


def states(identification):
    return {(c.valve, c.estimator): c.state for c in identification.states.kept()}


@pytest.mark.parametrize("n", [7_000, *soaked(12_000)])
def test_each_valve_is_learnt_nearly_as_with_a_meter_of_its_own(rows, n):
    """Over three draws of the noise: one draw moves a young map's error by half."""
    rows = {name: {k: v[:n] for k, v in own.items()} for name, own in rows.items()}
    found = {True: [], False: []}
    for shared, rmse in found.items():
        for seed in (2, 3, 4):
            maps = learnt(parts_of(rows, shared=shared, seed=seed), shared=shared)
            rmse.append([errors(maps, rows)[name][0] for name in VALVES])
    together, apart = (np.sqrt(np.mean(np.square(found[s]), axis=0)) for s in (True, False))
    assert (together < 2.5 * apart + 0.05).all(), (together, apart)


def test_any_cut_of_the_stream_gives_the_same_bits(rows):
    parts = [own[:1_500] for own in parts_of(rows)]
    whole = states(learnt(parts, estimator="RLS"))
    cuts = np.sort(np.random.default_rng(5).integers(1, 1_499, 20)).tolist()
    assert states(learnt(parts, cuts=cuts, estimator="RLS")) == whole


def test_valves_whose_samples_come_one_behind_the_other_give_the_same_bits(rows):
    parts = [own[:1_000] for own in parts_of(rows)]
    whole = states(learnt(parts, estimator="RLS"))
    identification = build_identification(config_of(shared=True, estimator="RLS"))
    for number, own in enumerate(parts):
        identification.learn(gathered({number: own}))
    assert states(identification) == whole


def test_a_restored_state_continues_as_if_it_had_not_been_interrupted(rows):
    parts = [own[:1_200] for own in parts_of(rows)]
    whole = learnt(parts, estimator="RLS")
    first = learnt([own[:700] for own in parts], estimator="RLS")
    first.learn(gathered({0: parts[0][700:705]}))  # these wait for those of the others
    second = build_identification(config_of(shared=True, estimator="RLS"))
    _, refused = second.restore(first.states.kept())
    assert not refused
    rest = {number: own[(705 if number == 0 else 700) :] for number, own in enumerate(parts)}
    second.learn(gathered(rest))
    assert states(second) == states(whole)


def test_the_state_of_other_valves_is_refused(rows):
    parts = [own[:200] for own in parts_of(rows)]
    kept = learnt(parts, estimator="RLS").states.kept()
    other = config_of(shared=True, estimator="RLS")
    narrow = other.valves[0].model_copy(update={"U_range_percent": (0.0, 80.0)})
    fewer = other.model_copy(update={"valves": (narrow, *other.valves[1:])})
    _, refused = build_identification(fewer).restore(kept)
    assert f"{VALVES[0]}.Meter" in refused


def test_one_valve_s_bad_signal_marks_the_samples_of_all(rows):
    parts = [own[:300] for own in parts_of(rows)]
    quality = parts[1].quality.copy()
    quality[100:110] = Quality.BAD
    parts[1] = replace(parts[1], quality=quality)
    meters = Meters(["m"] * 3, [(0.0, 100.0)] * 3)
    shared, used = meters.share(gathered(dict(enumerate(parts))), _raise)
    for valve, first, last in zip(*(x.tolist() for x in shared.segments), strict=True):
        bad = shared.samples.quality[first:last] == Quality.BAD
        assert bad[100:110].all()
        assert bad.sum() == 10
        assert used[valve][100:110].all()  # so that the gate counts them


def test_nothing_is_learnt_while_the_other_flows_are_unknown(rows):
    """At first, of the other valves it is known only that a shut one passes next to nothing."""
    parts = [own[:3_000] for own in parts_of(rows)]
    meters = Meters(["m"] * 3, [(0.0, 100.0)] * 3)
    shared, used = meters.share(gathered(dict(enumerate(parts))), _raise)
    opened = [own["U"][:3_000] > 0.5 for own in rows.values()]
    first_together = int(np.flatnonzero(np.sum(opened, axis=0) > 1)[0])
    assert not all(used[number][first_together] for number in range(3))
    for valve, first, last in zip(*(x.tolist() for x in shared.segments), strict=True):
        doubtful = shared.samples.quality[first:last] == Quality.UNCERTAIN
        assert doubtful[~used[valve]][:50].all()
        assert not (doubtful & used[valve]).any()
        own = flow(VALVES[valve], *_points(rows, VALVES[valve]))[:3_000]
        error = (shared.samples.Q[first:last] - own)[used[valve]]
        assert np.sqrt(np.mean(error**2)) < 1.3 * SIGMA


def test_a_sample_counts_by_what_it_says_of_a_valve_alone():
    """By the update of all weights together, written out with matrices."""
    rng = np.random.default_rng(3)
    meter = SharedMeter(((0.0, 100.0), (0.0, 100.0)))
    state = meter.initial_state()
    U, dp = rng.uniform(0.0, 100.0, (2, 400)), rng.uniform(20.0, 150.0, (2, 400))
    U[1, :200] = 0.0
    gains = np.array([[0.05], [0.02]])
    Q = (gains * U * np.sqrt(dp)).sum(axis=0) + rng.normal(0.0, SIGMA, 400)
    every = np.ones(400, np.bool_)
    meter.learn(state, U[:, :390], dp[:, :390], Q[:390], every[:390])
    state.held[:] = 0.0
    x = np.zeros((2, len(state.weights)))
    for m in range(2):
        knots = np.linspace(0.0, 100.0, len(state.weights) // 2)
        at = np.interp(U[m, 390], knots, np.arange(len(knots)))
        low = int(at)
        place = m * len(knots) + low
        x[m, [place, place + 1]] = np.array([1.0 - at + low, at - low]) * np.sqrt(dp[m, 390])
    A, S = x[0] @ state.P @ x[0], 1.0 + x.sum(axis=0) @ state.P @ x.sum(axis=0)
    gain = x[0] @ state.P @ x.sum(axis=0)
    left = A - gain**2 / S
    weight = 1.0 / left - 1.0 / A  # the information that the sample adds
    residual = Q[390] - x.sum(axis=0) @ state.weights
    moved = gain / S * residual
    meter.learn(state, U[:, 390:391], dp[:, 390:391], Q[390:391], every[:1])
    assert state.held[0, 0] == pytest.approx(weight)
    assert state.held[0, 1] / state.held[0, 0] == pytest.approx(moved / (1.0 - left / A))


@pytest.mark.parametrize(("leak", "most"), [(0.0, 0.003), (0.02, 0.01)])
def test_no_valve_leaks_more_than_all_together(leak, most):
    """The sum of the leaks is known before each one; that bounds them, and hides none."""
    rows = work(8, 60.0, leak)
    U = np.array([own["U"] for own in rows.values()])
    dp = np.array([own["p1"] - own["p2"] for own in rows.values()])
    total = parts_of(rows)[0].Q
    meter = SharedMeter(((0.0, 100.0),) * len(VALVES))
    state = meter.initial_state()
    meter.learn(state, U, dp, total, np.ones(len(total), np.bool_))
    shut = np.arange(len(VALVES)) * (len(state.weights) // len(VALVES))
    std = np.sqrt(np.diag(state.P)[shut]) * meter.noise(state)
    error = state.weights[shut] - leak * np.array([1.0, 0.5, 0.0])
    assert std.max() < most
    assert np.abs(error / std).max() < 3.0


@pytest.mark.parametrize("version", ["2", "3"])
def test_a_saved_meter_without_a_bound_of_its_leaks_gets_that_of_the_prior(version):
    fresh = SharedMeter(((0.0, 100.0),) * 2).initial_state()
    saved = {"sums": fresh.sums[:2].copy(), "dropped": np.array(0), "met": np.zeros(1)}
    assert np.array_equal(_Kept.upgraded(version, saved)["sums"], fresh.sums)
    of_others = {"sums": np.zeros(0), "dropped": np.array(0), "met": np.zeros(1)}
    assert len(_Kept.upgraded(version, of_others)["sums"]) == 0
    assert _Kept.upgraded("1", {"sums": np.zeros(2)}) == {}


def _points(rows, name):
    own = rows[name]
    return own["U"], own["p1"] - own["p2"]


def test_samples_that_never_meet_are_bounded_and_counted(rows):
    own = parts_of(rows)[0]
    meters = Meters(["m", "m", ""], [(0.0, 100.0)] * 3)
    for _ in range(3):
        n = MOST_WAITING
        samples = Samples.concatenate([own, own])[:n]
        arrived, _ = meters.share(gathered({0: samples}), _raise)
        assert len(arrived.samples) == 0
    assert meters.dropped.tolist() == [2 * MOST_WAITING, 0, 0]


def test_samples_without_those_of_the_other_valves_raise_the_alarm_of_losses(rows):
    parts = parts_of(rows)
    identification = build_identification(config_of(shared=True, estimator="RLS"))
    for first in range(0, 9_000, 100):
        some = {number: own[first : first + 100] for number, own in enumerate(parts)}
        if first % 500 == 0:  # a fifth comes without those of the others
            some[0] = replace(some[0], t=some[0].t + 3_000_000)
        identification.learn(gathered(some))
    found = {report.name: report for report in identification.alarms(VALVES[0])}
    assert found["SamplesLost"].active, list(found)


def _raise(_, error):
    raise error


def test_a_meter_that_fails_stops_its_own_valves_alone(rows, monkeypatch):
    parts = [own[:200] for own in parts_of(rows)]
    meters = Meters(["m", "m", ""], [(0.0, 100.0)] * 3)
    monkeypatch.setattr("valvemap.model.kernels.shared_meter.learn", None)
    stopped = []
    arrived, _ = meters.share(
        gathered(dict(enumerate(parts))), lambda valve, error: stopped.append(valve)
    )
    assert stopped == [0, 1]
    assert arrived.segments.members.tolist() == [2]


def toml(*valves, extra=""):
    text = ""
    for name, Q in valves:
        nodes = "\n".join(f'{n} = "s={name}.{n}"' for n in ("U", "p1", "p2"))
        text += f'[[valves]]\nname = "{name}"\n{extra}[valves.nodes]\n{nodes}\nQ = "{Q}"\n'
    return text


def test_valves_that_name_one_node_of_Q_share_its_meter(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text(toml(("A", "s=Q"), ("B", "s=Q"), ("C", "s=C.Q")))
    meters = [plan.meter for plan in build_plans(load_config(file))]
    assert meters[0] == meters[1] != ""
    assert meters[2] == ""


def test_more_valves_than_one_meter_bears_are_refused(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text(toml(*((f"V{k}", "s=Q") for k in range(9))))
    with pytest.raises(ConfigurationError, match="at most 8 valves may be behind one meter"):
        load_config(file)


def test_units_of_one_meter_that_differ_are_refused(tmp_path):
    file = tmp_path / "c.toml"
    other = toml(("B", "s=Q")) + '[valves.signals]\nQ = { unit = "gpm" }\n'
    file.write_text(toml(("A", "s=Q")) + other)
    with pytest.raises(ConfigurationError, match=r"signals\.Q must be the same"):
        load_config(file)


def test_edges_of_several_valves_behind_one_meter_are_refused(tmp_path):
    file = tmp_path / "c.toml"
    text = ""
    for name in "AB":
        nodes = "\n".join(f'{n} = "s={name}.{n}"' for n in ("U", "pP", "pT", "pA"))
        text += f'[[valves]]\nname = "{name}"\n[valves.ports]\n{nodes}\nQA = "s=Q"\n'
    file.write_text(text)
    with pytest.raises(ConfigurationError, match="need a meter in each line"):
        load_config(file)


def test_a_fleet_refuses_a_shared_meter(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text(toml(("A", "s=Q"), ("B", "s=Q")))
    with pytest.raises(ConfigurationError, match="A, B share a flow meter"):
        catalogue_of({"north": load_config(file)})
