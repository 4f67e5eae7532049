from dataclasses import replace

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.errors import CommandRejected
from valvemap.model.flow_map import FlowMap
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.sensor_accuracy import SensorAccuracy
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.maps_and_surveys import SURVEYS_AT_ONCE
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quality_gate import QualityGate, SignalLimits
from valvemap.vocabulary.signals import SENSORS
from valvemap.vocabulary.statuses import InverseStatus, Quality, Status


def thetas(identification):
    result = identification.results.one(0)
    return {name: r.theta.tobytes() for name, r in result.estimators.items()}


def test_data_changes_and_samples_teach_the_same_bits(identification, fresh):
    samples = plant(500)
    identification.take(as_changes(samples))
    replayed = fresh()
    for part in (samples[:123], samples[123:130], samples[130:]):
        replayed.take_samples(0, part)
    assert thetas(identification) == thetas(replayed)


def test_results_carry_the_time_of_their_sample(identification):
    samples = plant(300)
    identification.take_samples(0, samples)
    for result in identification.results.one(0).estimators.values():
        assert result.t == samples.t[-1]
        assert result.sample_count == 300
        assert result.residual == pytest.approx(samples.Q[-1] - result.predicted, abs=1e-9)


def test_before_the_first_sample_nothing_is_good(identification):
    for result in identification.results.one(0).estimators.values():
        assert result.status is Status.WARMING_UP
        assert result.quality is not Quality.GOOD
        assert np.isnan(result.predicted)


def test_lost_sensors_make_every_result_bad(identification):
    identification.take_samples(0, plant(300))
    (results,) = identification.results.of([0], lost=np.array([True]))
    result = results.one(0)
    assert {r.quality for r in result.estimators.values()} == {Quality.BAD}
    assert result.inverse.quality is Quality.BAD


def test_freeze_stops_learning_and_resume_goes_on(identification):
    identification.take_samples(0, plant(300))
    identification.do(Command.of("freeze", "Valvistor", "RLS"))
    before = thetas(identification)
    identification.take_samples(0, plant(50, seed=2, first=300))
    after = thetas(identification)
    assert after["RLS"] == before["RLS"]
    assert after["RML"] != before["RML"]
    result = identification.results.one(0).estimators["RLS"]
    assert (result.status, result.sample_count) == (Status.FROZEN, 300)
    assert np.isfinite(result.residual)
    identification.do(Command.of("resume", "Valvistor", "RLS"))
    identification.take_samples(0, plant(50, seed=3, first=350))
    assert thetas(identification)["RLS"] != before["RLS"]


def test_reset_forgets_the_samples_and_keeps_the_settings(identification):
    identification.do(Command.of("set_forgetting_factor", "Valvistor", "RLS", 0.97))
    identification.take_samples(0, plant(300))
    identification.do(Command.of("reset", "Valvistor", "RLS"))
    assert identification.results.one(0).estimators["RLS"].sample_count == 0
    assert identification.valves.lane("Valvistor", "RLS").estimator.lam == 0.97


@pytest.mark.parametrize("lam", [1e-300, 0.0, 0.8, -1.0, 1.01, np.nan, np.inf, -1e308])
def test_a_forgetting_factor_out_of_range_is_refused(identification, lam):
    with pytest.raises(CommandRejected, match=r"factor .*: allowed is 0\.8333 <= lam <= 1"):
        identification.do(Command.of("set_forgetting_factor", "Valvistor", "RLS", lam))


def test_a_network_has_no_forgetting_factor(identification):
    with pytest.raises(CommandRejected, match=r"Valvistor\.RBF has no forgetting factor"):
        identification.do(Command.of("set_forgetting_factor", "Valvistor", "RBF", 0.99))


def test_the_standing_demand_is_answered_and_predicted_back(identification):
    identification.take_samples(0, plant(2000))
    identification.do(Command.of("demand", "Valvistor", 60.0, 100.0))
    inverse = identification.results.one(0).inverse
    assert inverse.status == InverseStatus.OK
    Q, std, status = identification.predict("Valvistor", "RLS", inverse.required_U, 100.0, 40.0)
    assert pytest.approx(60.0, abs=1e-6) == Q
    assert 0 < std < 1
    assert status is Status.OK
    identification.do(Command.of("demand", "Valvistor", np.nan, np.nan))
    assert np.isnan(identification.results.one(0).inverse.required_U)


def test_a_restart_goes_on_as_if_there_had_been_none(identification, fresh):
    samples = plant(600)
    identification.do(Command.of("set_forgetting_factor", "Valvistor", "RLS", 0.98))
    identification.take_samples(0, samples[:300])
    restarted = fresh()
    restored, refused = restarted.restore(identification.states.checkpoints())
    assert (len(restored), refused) == (3, {})
    identification.take_samples(0, samples[300:])
    restarted.take_samples(0, samples[300:])
    assert thetas(restarted) == thetas(identification)
    assert restarted.results.one(0).estimators["RLS"].sample_count == 600


def test_a_demand_stands_over_a_restart_and_is_named(identification, fresh):
    identification.take_samples(0, plant(100))
    assert identification.answers.demands() == {}
    identification.do(Command.of("demand", "Valvistor", 60.0, 100.0))
    restarted = fresh()
    states = identification.states
    restarted.restore([*states.checkpoints(), *states.memories()])
    assert restarted.answers.demands() == {"Valvistor": (60.0, 100.0)}


def test_states_of_another_configuration_are_left_aside(identification, fresh):
    identification.take_samples(0, plant(100))
    kept = identification.states.checkpoints()
    other = [type(c)(**{**vars(c), "key": "x", "state": b"damaged"}) for c in kept]
    restarted = fresh()
    restored, refused = restarted.restore(other)
    assert (restored, list(refused)) == ([], ["Valvistor.RLS", "Valvistor.RML", "Valvistor.RBF"])
    assert restarted.results.one(0).estimators["RLS"].sample_count == 0


def test_bad_samples_are_counted_and_teach_nothing(identification):
    samples = plant(300)
    identification.take_samples(0, samples)
    before = thetas(identification)
    broken = plant(10, seed=5, first=300)
    broken.Q[:] = np.nan
    identification.take_samples(0, broken)
    assert thetas(identification) == before
    assert identification.results.counters(0)["not_finite"] == 10
    assert {r.quality for r in identification.results.one(0).estimators.values()} == {Quality.BAD}


def test_a_new_measurement_is_expected_within_the_noise_of_the_residuals(identification):
    identification.take_samples(0, plant(3000))
    for name, result in identification.results.one(0).estimators.items():
        Q, lower, upper, status = identification.predict_measurement(
            "Valvistor", name, 50.0, 100.0, np.nan
        )
        assert (Q, status) == (identification.predict("Valvistor", name, 50.0, 100.0, np.nan)[::2])
        assert 1.0 < (upper - lower) / result.noise_std < 8.0
    checkpoints = identification.states.checkpoints()
    before = identification.valves.lane("Valvistor", "RLS").spread
    identification.do(Command.of("reset", "Valvistor", "RLS"))
    assert np.isnan(identification.results.one(0).estimators["RLS"].noise_std)
    identification.restore(checkpoints)
    after = identification.valves.lane("Valvistor", "RLS").spread
    assert after.cells.tobytes() == before.cells.tobytes()
    assert after.multiple == before.multiple
    assert len(identification.valves.lane("Valvistor", "RLS").support.boxes) > 100


def test_every_map_is_surveyed_when_the_inverse_is_tabulated_anew(identification):
    identification.take_samples(0, plant(1000))
    assert identification.results.one(0).estimators["RLS"].survey is None
    identification.maps.refresh()
    for result in identification.results.one(0).estimators.values():
        assert result.survey.std.shape == (10, 10)
        assert np.nanmin(result.survey.age_s) >= 0.0
        assert 0.5 < result.survey.share <= 1.0
        assert 0.0 <= result.survey.suggested_U <= 100.0


def test_a_fleet_is_surveyed_in_turns(plan):
    plans = [replace(plan, name=f"V{k}") for k in range(20)]
    fleet = Identification(plans, Alignment(AlignmentSettings(), optional=(("T",),) * 20))
    seen = []
    for _ in range(2):
        fleet.maps.refresh()
        results = (fleet.results.one(k).estimators.values() for k in range(20))
        seen.append(sum(r.survey is not None for group in results for r in group))
    assert seen == [SURVEYS_AT_ONCE, 3 * 20]


def test_a_U_that_an_estimator_cannot_describe_is_counted_and_teaches_nothing(identification):
    identification.take_samples(0, plant(300))
    before = thetas(identification)
    other_edge = plant(50, seed=5, first=300)
    other_edge.U[:] -= 110.0
    identification.take_samples(0, other_edge)
    assert thetas(identification) == before
    assert identification.results.counters(0)["beyond_range"] == 50
    assert identification.results.counters(0)["out_of_range"] == 0
    for result in identification.results.one(0).estimators.values():
        assert (result.status, result.quality) == (Status.EXTRAPOLATING, Quality.UNCERTAIN)
        assert result.sample_count == 300
        assert np.isnan(result.residual)
    closed = plant(20, seed=6, first=350)
    closed.U[:] = -1.0  # a sensor about a closed valve
    identification.take_samples(0, closed)
    assert identification.results.one(0).estimators["RLS"].status is Status.OK
    assert identification.results.counters(0)["beyond_range"] == 50


def test_a_pressure_drop_beyond_a_map_is_counted_and_teaches_it_nothing(identification):
    identification.take_samples(0, plant(300))
    before = {name: r.theta for name, r in identification.results.one(0).estimators.items()}
    steep = plant(50, seed=5, first=300)
    steep.p1[:] += 300.0  # the maps end at 200 bar
    identification.take_samples(0, steep)
    assert identification.results.counters(0)["beyond_range"] == 50
    for name, result in identification.results.one(0).estimators.items():
        is_formula = name in {"RLS", "RML"}
        assert (result.status is not Status.EXTRAPOLATING) == is_formula
        if not is_formula:
            np.testing.assert_array_equal(result.theta, before[name])
            assert result.sample_count == 300


def test_what_the_sensors_may_be_off_by_is_in_the_interval_of_the_true_flow_alone(plan):
    doubted = replace(plan, accuracy=SensorAccuracy(p1=1.0, p2=1.0, Q=0.5))
    one, other = (
        Identification([each], Alignment(AlignmentSettings(), optional=(("T",),)))
        for each in (plan, doubted)
    )
    for identification in (one, other):
        identification.take_samples(0, plant(500))
        identification.do(Command.of("demand", "Valvistor", 60.0, 80.0))
    point = "Valvistor", "RLS", 50.0, 100.0, 40.0
    sure, doubtful = one.predict(*point), other.predict(*point)
    slope = 0.1 * 50.0 / 20.0 - 0.02
    off = np.sqrt((2 * slope**2 + 0.5**2) / 3)
    assert (doubtful[0], doubtful[2]) == (sure[0], sure[2])
    assert doubtful[1] == pytest.approx(np.hypot(sure[1], off), rel=0.05)
    assert one.predict_measurement(*point) == other.predict_measurement(*point)
    demand = "Valvistor", 60.0, 80.0, 40.0
    widths = [float(i.invert(*demand).upper[0] - i.invert(*demand).lower[0]) for i in (one, other)]
    assert widths[1] > 2 * widths[0]
    published = [i.results.one(0).estimators["RLS"].systematic_std for i in (one, other)]
    assert np.isnan(published[0])
    assert 0.2886 < published[1] < 2.0  # that of Q at least


def test_samples_beyond_a_meters_end_are_counted_where_everybody_sees(plan):
    ending = replace(plan, estimators={"Auto": FlowMap()}, inverse="Auto")
    identification = Identification([ending], Alignment(AlignmentSettings(), optional=(("T",),)))
    samples = plant(4000)
    samples.Q[:] = np.minimum(samples.Q, 50.0)
    identification.take_samples(0, samples)
    assert identification.results.counters(0)["censored"] > 100


def test_a_network_that_is_given_both_edges_learns_both_and_inverts_both(plan):
    network = RbfNetwork(U_range=(-100.0, 100.0), dp_range=(0.0, 200.0))
    both = replace(plan, estimators={"RBF": network}, inverse="RBF", U_range=(-100.0, 100.0))
    identification = Identification([both], Alignment(AlignmentSettings(), optional=(("T",),)))
    for k in range(4):
        samples = plant(5000, seed=k, first=5000 * k)
        samples.U[::2] *= -1.0
        samples.Q[::2] *= -1.0
        identification.take_samples(0, samples)
    assert identification.results.counters(0)["beyond_range"] == 0
    for Q in (70.0, -70.0):
        answer = identification.invert("Valvistor", Q, 100.0, 40.0)
        assert answer.status[0] == InverseStatus.OK
        assert answer.U[0] == pytest.approx(Q / 1.0, abs=15.0)
        assert answer.lower[0] < answer.U[0] < answer.upper[0]


def test_where_nothing_was_measured_predict_invert_and_the_demand_say_extrapolating(identification):
    samples = plant(3000)
    part = (samples.U < 40.0) & (samples.dp < 60.0)
    identification.take_samples(0, samples[part])
    assert identification.predict("Valvistor", "RBF", 20.0, 30.0, 40.0)[2] is Status.OK
    for name in ("RBF", "RLS", "RML"):
        _, std, status = identification.predict("Valvistor", name, 90.0, 180.0, 70.0)
        assert status is Status.EXTRAPOLATING
        assert std > 1.0
    answer = identification.invert("Valvistor", 100.0, 150.0, 70.0)
    assert answer.status[0] == InverseStatus.EXTRAPOLATING
    assert answer.lower[0] < answer.U[0] < answer.upper[0]
    identification.do(Command.of("demand", "Valvistor", 20.0, 50.0))
    assert identification.results.one(0).inverse.status == InverseStatus.OK
    hot = samples[part][:1]
    hot.T[:] = 80.0
    identification.take_samples(0, hot)
    assert identification.results.one(0).inverse.status == InverseStatus.EXTRAPOLATING
    identification.do(Command.of("reset", "Valvistor", "RLS"))
    assert len(identification.valves.lane("Valvistor", "RLS").support.boxes) == 0


def test_swapped_pressures_teach_nothing_until_somebody_insists(fresh):
    samples = plant(300)
    swapped = replace(samples, p1=samples.p2, p2=samples.p1)
    doubting = fresh()
    for part in (swapped[:30], swapped[30:]):
        doubting.take(as_changes(part))
    assert doubting.plausibility.implausible.tolist() == [True]
    assert "p1 is below p2" in doubting.plausibility.findings(0)[0].sentence
    result = doubting.results.one(0).estimators["RLS"]
    assert (result.sample_count, result.status) == (0, Status.REJECTED)
    insisting = Identification(
        [replace(plan, insist=True) for plan in doubting.plans],
        Alignment(AlignmentSettings(), (("T",),)),
    )
    insisting.take(as_changes(swapped))
    assert insisting.results.one(0).estimators["RLS"].sample_count == 300


def test_the_newest_sample_is_published_as_the_source_sent_it(identification):
    samples = plant(20)
    identification.take(as_changes(samples))
    (results,) = identification.results.of([0])
    last = samples[19:]
    assert results.signals.t.tolist() == last.t.tolist()
    expected = [x[0] for x in (last.U, last.p1, last.p2, last.Q, last.dp, last.T)]
    assert results.signals.values.tolist() == [expected]
    assert results.signals.quality.tolist() == [Quality.GOOD]
    (results,) = identification.results.of([0], lost=np.array([True]))
    assert results.signals.quality.tolist() == [Quality.BAD]


GATED = {
    signal: SignalLimits(*signal.plausible, frozen_s=5.0, max_rate_per_s=1e5, spike=80.0)
    for signal in SENSORS
}


def test_after_a_restart_at_any_change_all_goes_on_to_the_bit(plan):
    gated = replace(plan, gate=QualityGate(limits=GATED))
    align = Alignment(AlignmentSettings(), optional=(("T",),), has_sequence=(True,))
    changes = as_changes(plant(400))
    lost = np.r_[0 : 6 * 120, 6 * 122 : len(changes)]  # a hole, behind which samples wait
    changes = DataChanges(*(column[lost] for column in vars(changes).values()))
    changes.value[6 * 200 + 3] += 500.0  # a spike
    changes.value[6 * 300 + 1] = np.nan

    def fresh():
        return Identification([gated], align)

    whole = fresh()
    whole.do(Command.of("demand", "Valvistor", 50.0, 100.0))
    whole.do(Command.of("freeze", "Valvistor", "RML"))
    whole.take(changes)
    rng = np.random.default_rng(3)
    part, at = fresh(), 0
    part.do(Command.of("demand", "Valvistor", 50.0, 100.0))
    part.do(Command.of("freeze", "Valvistor", "RML"))
    for until in [*np.sort(rng.integers(0, len(changes), 12)).tolist(), len(changes)]:
        part.take(changes[at:until])
        kept, at = [*part.states.checkpoints(), *part.states.memories()], until
        part = fresh()
        restored, refused = part.restore(kept)
        assert (len(restored), refused) == (6, {})
    assert part.states.checkpoints() == whole.states.checkpoints()
    assert part.states.memories() == whole.states.memories()
    assert part.results.counters(0) == whole.results.counters(0)
    assert whole.results.counters(0)["spike"] > 0
    ours, theirs = part.results.one(0), whole.results.one(0)
    assert (ours.inverse.required_U, ours.inverse.armed) == (theirs.inverse.required_U, False)
    for name, result in theirs.estimators.items():
        assert ours.estimators[name].status is result.status
        assert ours.estimators[name].residual == pytest.approx(result.residual, nan_ok=True, rel=0)


def test_the_memory_of_a_valve_with_another_gate_is_left_aside(plan, identification):
    identification.take(as_changes(plant(50)))
    kept = [*identification.states.checkpoints(), *identification.states.memories()]
    other = replace(plan, gate=QualityGate(limits=GATED))
    restarted = Identification([other], Alignment(AlignmentSettings(), optional=(("T",),)))
    restored, refused = restarted.restore(kept)
    assert (len(restored), list(refused)) == (5, ["Valvistor.Diagnostics"])
