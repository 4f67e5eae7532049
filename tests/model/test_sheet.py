"""A valve's sheet: figures near the truth, intervals that hold it, words where there is none."""

import math

import numpy as np
import pytest

from benchmarks.commission_plant import VALVES
from benchmarks.sheet import RATED_BAR, swept, truth_of
from valvemap.model.judged_sheet import Verdict, judge
from valvemap.model.samples import Samples
from valvemap.model.sheet import Figure, Measured, SheetError, make_sheet
from valvemap.model.sheet_figures import names_of
from valvemap.model.sweep_equations import Problem, spool

NEAR = {
    "rated_flow": 0.5,
    "dead_band": 0.6,
    "flow_gain": 0.02,
    "linearity": 0.6,
    "leakage": 0.4,
    "hysteresis": 0.3,
    "saturation": 1.5,
    "symmetry": 0.5,
}


def sheet_of(name, seed=7, **how):
    valve = VALVES[name]
    return make_sheet(swept(valve, seed, **how), RATED_BAR, valve.U_range), truth_of(valve)


@pytest.mark.parametrize("play", [0.0, 0.3, 2.0, 250.0])
@pytest.mark.parametrize("lag", [0.0, 0.02])
@pytest.mark.parametrize("n", [1, 2, 7, 1000])
def test_the_spool_follows_step_by_step(play, lag, n):
    rng = np.random.default_rng(n)
    U, dt = np.cumsum(rng.normal(0, 0.5, n)), rng.uniform(0.005, 0.02, n)
    at = follows = float(U[0])
    x = []
    for to, share in zip(U, 1.0 - np.exp(-dt / lag) if lag else np.ones(n), strict=True):
        at = min(max(at, to - play / 2), to + play / 2)
        follows += share * (at - follows)
        x.append(follows)
    assert spool(U, dt, play, lag).tolist() == x


def test_figures_are_near_the_truth_and_their_intervals_hold_it():
    held = []
    for name in ("dead band 8 %, play 2 %", "saturating, play 3 %", "U of both signs, play 3 %"):
        sheet, truth = sheet_of(name)
        assert not sheet.not_a_test
        for figure in sheet.figures:
            true = truth.get((figure.key, figure.side), math.nan)
            if not math.isfinite(true):
                assert figure.reason, figure
                continue
            assert figure.value == pytest.approx(true, abs=NEAR[figure.key]), figure
            held.append(figure.lower <= true <= figure.upper)
    assert len(held) >= 22
    assert np.mean(held) >= 0.8


def test_samples_at_other_pressure_drops_count_fully_where_the_equation_holds_there():
    farthest = {}
    for name in ("U of both signs, play 3 %", "compensator's knee"):
        valve = VALVES[name]
        samples = swept(valve, 7)
        problem = Problem(samples, RATED_BAR, np.linspace(*valve.U_range, 101))
        problem.weigh_drops(valve.play, 0.005)
        farthest[name] = float(problem.weight[np.argmax(np.abs(samples.dp - RATED_BAR))])
    assert farthest["U of both signs, play 3 %"] > 0.7
    assert farthest["compensator's knee"] < 0.5


@pytest.mark.parametrize("name", ["S-shape, play 4 %", "compensator's knee"])
def test_another_law_of_the_pressure_drop_does_not_shift_the_curve(name):
    sheet, truth = sheet_of(name, 5)
    for key, near in (("rated_flow", 0.15), ("leakage", 0.15)):
        figure = next(one for one in sheet.figures if one.key == key)
        assert figure.value == pytest.approx(truth[key, ""], abs=near)
        assert figure.lower <= truth[key, ""] <= figure.upper


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_intervals_hold_and_the_spread_is_at_most_twice_that_of_a_classic_sweep():
    held, guided, classic = [], {}, {}
    for name in VALVES:
        for seed in range(20):
            for found, how in ((guided, {}), (classic, {"classic": True})):
                sheet, truth = sheet_of(name, 300 + seed, **how)
                for figure in sheet.figures:
                    true = truth.get((figure.key, figure.side), math.nan)
                    if figure.measured is Measured.MEASURED and math.isfinite(true):
                        found.setdefault((figure.key, figure.side, name), []).append(figure.value)
                        if found is guided:
                            held.append(figure.lower <= true <= figure.upper)
    assert 0.90 <= np.mean(held) <= 0.98

    def spread(found, key):
        return np.sqrt(np.mean([np.var(v, ddof=1) for (k, *_), v in found.items() if k == key]))

    ratios = {key: spread(guided, key) / spread(classic, key) for key, *_ in guided}
    assert max(ratios.values()) <= 2.0, ratios


def test_slow_samples_are_no_test():
    slow = swept(VALVES["ordinary, no play"], 1)[::4]
    assert "the samples come at 25 Hz" in make_sheet(slow, RATED_BAR).not_a_test


def test_what_was_not_driven_is_not_measured():
    valve = VALVES["ordinary, no play"]
    whole = swept(valve, 1)
    half = whole[np.flatnonzero(whole.U < 49.0)]
    sheet = make_sheet(half, RATED_BAR)
    by_key = {figure.key: figure for figure in sheet.figures}
    assert by_key["rated_flow"].measured is Measured.NOT_MEASURED
    assert "U was 49" in by_key["rated_flow"].reason
    assert "0 times" in sheet.not_a_test
    assert set(by_key) == set(names_of(1))


def test_machine_work_is_no_test():
    rng = np.random.default_rng(2)
    n = 6000
    U = np.clip(50 + np.cumsum(rng.normal(0, 2.0, n)), 0, 100)
    dp = 70 + 20 * np.sin(np.arange(n) / 300)
    Q = 0.1 * U * np.sqrt(dp) + rng.normal(0, 0.4, n)
    samples = Samples.of(t=np.arange(n) * 10**7, U=U, p1=200 + 0 * dp, p2=200 - dp, Q=Q)
    assert make_sheet(samples, 70.0).not_a_test


def test_a_rated_pressure_drop_beyond_the_data_is_refused_with_what_is_there():
    with pytest.raises(SheetError, match=r"rated Δp is 300 bar; the recording has 2\.\d+ to 195"):
        make_sheet(swept(VALVES["ordinary, no play"], 1), 300.0)
    with pytest.raises(SheetError, match="no samples"):
        make_sheet(Samples.of(t=[], U=[], p1=[], p2=[], Q=[]))


def test_missing_values_and_bad_samples_are_left_out():
    whole = swept(VALVES["ordinary, no play"], 3)
    Q = whole.Q.copy()
    Q[::7] = np.nan
    T = np.full(len(Q), np.nan)
    holed = Samples.of(t=whole.t, U=whole.U, p1=whole.p1, p2=whole.p2, Q=Q, T=T)
    (found,) = (f for f in make_sheet(holed, RATED_BAR).figures if f.key == "rated_flow")
    (true,) = (
        v for (key, _), v in truth_of(VALVES["ordinary, no play"]).items() if key == "rated_flow"
    )
    assert found.value == pytest.approx(true, abs=0.5)


@pytest.mark.parametrize("U", [0.0, 50.0, 100.0])
def test_a_valve_that_stands_still_has_no_curve(U):
    n = 600
    Q = np.random.default_rng(1).normal(0, 0.4, n)
    still = Samples.of(t=np.arange(n) * 10**7, U=np.full(n, U), p1=Q * 0 + 70, p2=Q * 0, Q=Q)
    with pytest.raises(SheetError, match="U and Q must change"):
        make_sheet(still)


def test_a_valve_without_flow_or_signal_has_no_curve():
    whole = swept(VALVES["ordinary, no play"], 1)
    none = np.zeros(len(whole))
    closed = Samples.of(t=whole.t, U=whole.U, p1=70 + none, p2=none, Q=none)
    with pytest.raises(SheetError, match="U and Q must change"):
        make_sheet(closed)
    gone = Samples.of(t=whole.t, U=none * np.nan, p1=70 + none, p2=none, Q=none)
    with pytest.raises(SheetError, match="no samples"):
        make_sheet(gone)


def test_a_verdict_needs_the_whole_interval():
    def figure(measured=Measured.MEASURED):
        return Figure("leakage", "", "leakage", "l/min", "", measured, 1.0, 0.9, 1.1)

    assert judge(figure(), 0.0, 2.0) is Verdict.PASS
    assert judge(figure(), 1.0, 2.0) is Verdict.UNDECIDED
    assert judge(figure(), 1.2, 2.0) is Verdict.FAIL
    assert judge(figure(Measured.NOT_MEASURED), 0.0, 2.0) is Verdict.UNDECIDED
