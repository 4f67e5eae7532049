"""The edges of a cylinder's valve from position and pressures, against the rig's truth."""

import numpy as np
import pytest

from support.soaked import soaked
from valvemap.model import axis_search
from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_basis import COMMON, leakage_share
from valvemap.model.axis_fit import fit
from valvemap.model.axis_search import fitted, identify
from valvemap.model.kernels.axis_rows import USED
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.statuses import AxisStatus
from valvemap_rig.directional import DirectionalValve, true_edge_flow
from valvemap_rig.machine import Cylinder, Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
KNOWN = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0)
SIGMA = 0.4  # l/min


def machine(**cylinder):
    valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
    return Machine(name="Axis", measures="position", valve=valve, cylinder=Cylinder(**cylinder))


def played(axis, seconds=120, rate=100.0, **commands):
    scenario = Scenario(valves=(), machines=(axis,), sample_rate_hz=rate)
    _, block = advance(scenario, initial(scenario, 0), round(seconds * rate), Commands(**commands))
    return block.machines["Axis"]


def of(block, *without):
    shown = {name: v.copy() for name, v in block.shown.items() if name not in without}
    return AxisSamples.of(block.t, **shown)


@pytest.fixture(scope="module")
def block():
    return played(machine())


def error(axis, found, factors=None):
    """Return the error over the four edges, σ."""
    U, dp = np.meshgrid(np.arange(12.0, 60.0, 6.0), [40.0, 80.0, 120.0])
    off = [
        found.flow(edge, U, dp)
        - true_edge_flow(axis.valve, edge, U, dp, (factors or {}).get(edge, 1.0))
        for edge in EDGES
    ]
    return float(np.sqrt(np.mean(np.square(off)))) / SIGMA


def test_edges_bulk_modulus_and_leakage_are_the_rigs(block):
    axis = machine()
    state, found = fitted(KNOWN, of(block))
    assert error(axis, found) < 0.2
    beta, std = found.bulk_modulus
    assert beta == pytest.approx(0.9, rel=0.02)
    assert 0 < std < 0.02
    assert found.leakage[0] == pytest.approx(0.002, rel=0.1)
    assert state.reasons()["used"] > 11_000


def test_any_division_of_the_samples_gives_the_same_bits(block):
    samples = of(block)[:3_000]
    samples.pA[1_000:1_020] = np.nan
    forgetting = AxisRegression(GEOMETRY, play_percent=1.0, spool_hz=50.0, memory_s=20.0)
    whole, trace = forgetting.update(forgetting.initial_state(), samples)
    state, reasons = forgetting.initial_state(), []
    for start, end in ((0, 1), (1, 1), (1, 998), (998, 1_011), (1_011, 3_000)):
        state, part = forgetting.update(state, samples[start:end])
        reasons.append(part.reason)
    for name, array in vars(whole).items():
        assert array.tobytes() == getattr(state, name).tobytes(), name
    assert np.array_equal(np.concatenate(reasons), trace.reason)


def test_intervals_that_the_caller_leaves_out_are_in_no_sum(block):
    samples = of(block)[:3_000]
    _, trace = KNOWN.update(KNOWN.initial_state(), samples)
    chosen = np.zeros(len(samples), np.bool_)
    chosen[1_000:1_200] = True
    state, less = KNOWN.update(KNOWN.initial_state(), samples, chosen)
    used = (trace.reason == USED) & ~chosen
    assert np.array_equal(less.reason == USED, used)
    assert state.rows == used.sum()
    samples.x[1_000:1_199] += 50.0
    again, _ = KNOWN.update(KNOWN.initial_state(), samples, chosen)
    assert np.array_equal(again.M[:COMMON, :COMMON], state.M[:COMMON, :COMMON])


def test_an_update_leaves_its_state_as_it_was(block):
    state = KNOWN.initial_state()
    KNOWN.update(state, of(block)[:100])
    assert not state.M.any()


def test_missing_values_and_gaps_are_left_out_and_harm_nothing(block):
    samples = of(block)
    samples.x[2_000:2_050] = np.nan
    holes = AxisSamples.of(
        np.delete(samples.t, slice(5_000, 5_300)),
        **{
            name: np.delete(getattr(samples, name), slice(5_000, 5_300))
            for name in ("U", "x", "pA", "pB", "pS", "pT", "T")
        },
    )
    state, found = fitted(KNOWN, holes)
    assert state.reasons()["missing"] == 50
    assert error(machine(), found) < 0.2


def test_where_intervals_are_left_out_the_position_s_noise_is_not_learnt(block):
    noisy = of(block)
    noisy.x[:] += 0.5 * np.random.default_rng(1).standard_normal(len(noisy))
    _, whole = fitted(KNOWN, noisy)
    for start in range(100, 12_000, 200):
        noisy.pA[start : start + 3] = 1.0
    state, broken = fitted(KNOWN, noisy)
    assert state.reasons()["low pressure"] > 200
    assert broken.residual_std < 1.1 * whole.residual_std


def test_a_wrong_piston_area_scales_the_flows_and_not_the_speeds(block):
    larger = AxisGeometry(63 * 1.1**0.5, 45 * 1.1**0.5, 800, 1.2, 1.2)
    own = fitted(KNOWN, of(block))[1]
    wrong = fitted(AxisRegression(larger, play_percent=2.0, spool_hz=40.0), of(block))[1]
    U, dp = np.array([20.0, 40.0]), np.array([60.0, 60.0])
    ratio = wrong.flow("PA", U, dp) / own.flow("PA", U, dp)
    assert ratio == pytest.approx(larger.A_A / GEOMETRY.A_A, rel=0.01)
    assert wrong.residual_std < 2 * own.residual_std


def test_the_leakage_of_warm_oil_is_that_at_forty_degrees():
    axis = machine(leakage_l_min_bar=0.01)
    warm = axis.model_copy(update={"supply": axis.supply.model_copy(update={"tank_C": 60.0})})
    block = played(warm)
    assert fitted(KNOWN, of(block))[1].leakage[0] == pytest.approx(0.01, rel=0.03)
    blind = fitted(KNOWN, of(block, "T"))[1].leakage[0]
    assert blind == pytest.approx(0.01 * leakage_share(60.0), rel=0.03)
    absurd = of(block)
    absurd.T[5_000:5_010] = [np.nan, np.inf, 1e308, -1e308, -273.15, 1e4, -300.0, 0.0, 0.0, 60.0]
    assert fitted(KNOWN, absurd)[1].leakage[0] == pytest.approx(0.01, rel=0.03)


def test_forgetting_follows_a_damaged_edge():
    from valvemap_rig.faults import Fault

    axis = machine()
    scenario = Scenario(valves=(), machines=(axis,))
    state, before = advance(scenario, initial(scenario, 0), 6_000)
    damage = Fault(kind="damage", edge="PA", size=-20)
    _, after = advance(scenario, state, 6_000, Commands(faults=(("Axis", damage),)))
    forgetting = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0, memory_s=10.0)
    learnt, _ = forgetting.update(forgetting.initial_state(), of(before.machines["Axis"]))
    assert error(axis, fit(forgetting, learnt)) < 0.5
    learnt, _ = forgetting.update(learnt, of(after.machines["Axis"]))
    assert error(axis, fit(forgetting, learnt), {"PA": 0.8}) < 0.5


@pytest.mark.soak
def test_play_and_spool_are_found_by_the_residual(block):
    result = identify(of(block), GEOMETRY)
    assert result.status is AxisStatus.OK
    assert result.fit.regression.play_percent == pytest.approx(2.0, abs=0.2)
    assert result.fit.regression.spool_hz == pytest.approx(40.0, rel=0.3)
    assert error(machine(), result.fit) < 0.3


@pytest.mark.parametrize("seconds", [80, *soaked(120)])
def test_a_slow_spool_is_found_too(seconds):
    one = machine()
    slow = one.model_copy(
        update={"valve": one.valve.model_copy(update={"natural_frequency_hz": 9.0})}
    )
    found = identify(of(played(slow, seconds=seconds)), GEOMETRY).fit.regression
    assert found.spool_hz == pytest.approx(9.0, rel=0.1)
    assert found.play_percent == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize(
    ("without", "status", "words"),
    [
        (("pA", "pB", "pS", "pT"), AxisStatus.NO_PRESSURES, "position and command alone"),
        (("pB",), AxisStatus.MISSING_PRESSURE, "pB missing"),
        (("pS", "pT"), AxisStatus.MISSING_PRESSURE, "pS, pT missing"),
        (("x",), AxisStatus.MISSING_SIGNAL, "x missing"),
    ],
)
def test_without_a_signal_there_is_no_map_and_the_sentence_names_it(block, without, status, words):
    result = identify(of(block, *without), GEOMETRY)
    assert result.status is status
    assert words in result.sentence
    assert result.fit is None


def test_slow_and_short_recordings_are_refused(block):
    slow = of(block)
    slow = AxisSamples.of(
        slow.t[::10], **{n: getattr(slow, n)[::10] for n in ("U", "x", "pA", "pB", "pS", "pT")}
    )
    assert identify(slow, GEOMETRY).status is AxisStatus.TOO_SLOW
    short = identify(of(block)[:3_000], GEOMETRY, searched=False)
    assert short.status is AxisStatus.TOO_SHORT
    assert "30 s of use" in short.sentence
    assert identify(of(block)[:1], GEOMETRY).status is AxisStatus.TOO_SHORT


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        (lambda x: x + 300.0, "mm, the stroke 0 … 800 mm"),
        (lambda x: x - 300.0, "mm, the stroke 0 … 800 mm"),
        (lambda x: x / 1000.0, "of a stroke of 800 mm: is it in mm?"),
    ],
)
def test_positions_that_contradict_the_stroke_are_refused(block, moved, words):
    samples = of(block)
    samples.x[:] = moved(samples.x)
    result = identify(samples, GEOMETRY, searched=False)
    assert result.status is AxisStatus.SIGNAL_INCONSISTENT
    assert words in result.sentence


def test_at_an_end_stop_and_below_three_bar_nothing_is_learnt(block):
    held = played(machine().model_copy(update={"controller": None}), U={"Axis": 40.0})
    result = identify(of(held), GEOMETRY, searched=False)
    assert result.status is AxisStatus.END_STOPS
    empty = of(block)
    empty.pB[:] = 1.0
    result = identify(empty, GEOMETRY, searched=False)
    assert result.status is AxisStatus.LOW_PRESSURE


def test_a_recording_of_rest_is_refused_before_a_search(block, monkeypatch):
    monkeypatch.setattr(axis_search, "with_spool", None)
    still = of(block)
    still.x[:], still.U[:] = 400.0, 0.0
    result = identify(still, GEOMETRY)
    assert result.status is AxisStatus.TOO_SHORT
    assert result.left_out["at rest"] > 11_000


def test_pressures_in_another_unit_give_an_implausible_bulk_modulus(block):
    wrong = of(block)
    for name in ("pA", "pB", "pS", "pT"):
        getattr(wrong, name)[:] *= 14.5
    result = identify(wrong, GEOMETRY, searched=False)
    assert result.status is AxisStatus.BULK_MODULUS


def test_one_direction_alone_does_not_open_all_edges(block):
    one = of(block)
    one.U[:] = np.abs(one.U)
    assert identify(one, GEOMETRY, searched=False).status in {
        AxisStatus.UNEXCITED,
        AxisStatus.BULK_MODULUS,
    }
