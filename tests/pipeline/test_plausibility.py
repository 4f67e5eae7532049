"""Signals that cannot be what they are called are found; those of a sound plant never."""

import numpy as np
import pytest

from benchmarks import measured_data
from support.soaked import soaked
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.plausibility import Kind, Plausibility
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import advance, initial

N = 6_000


def plant(seed=0, n=N, **changes):
    """A valve on a machine: U and dp along ramps and holds, T about 45 °C."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0, n + 200, 100)
    U = np.interp(np.arange(n), knots, rng.uniform(0, 100, len(knots)))
    dp = np.interp(np.arange(n), knots + 37, rng.uniform(3, 190, len(knots)))
    Q = 0.12 * np.clip(U - 6, 0, None) * np.sqrt(dp) + rng.normal(0, 0.4, n)
    columns = {
        "t": np.arange(n) * 10_000_000,
        "U": U,
        "p1": dp + 5,
        "p2": np.full(n, 5.0),
        "Q": Q,
        "T": np.full(n, 45.0),
    }
    return Samples.of(**(columns | {k: change(columns) for k, change in changes.items()}))


def findings(samples, parts=1):
    plausibility = Plausibility(1)
    for rows in np.array_split(np.arange(len(samples)), parts):
        part = samples[slice(rows[0], rows[-1] + 1)]
        plausibility.count(part, Segments.one(len(part)))
    return plausibility.findings(0)


def said(samples):
    return {finding.kind: finding.sentence for finding in findings(samples)}


def test_a_sound_plant_is_left_alone():
    for seed in range(5):
        assert findings(plant(seed)) == []


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"p1": lambda c: c["p2"], "p2": lambda c: c["p1"]}, "p1 is below p2 in 100 % of the"),
        ({s: lambda c, s=s: c[s] * 14.5 for s in ("p1", "p2")}, "is it psi? signals.p1.unit"),
        ({s: lambda c, s=s: c[s] * 1e5 for s in ("p1", "p2")}, "is it Pa?"),
        ({s: lambda c, s=s: c[s] * 100 for s in ("p1", "p2")}, "is it kPa?"),
        ({"Q": lambda c: -c["Q"]}, "Q falls where p1 - p2 rises"),
        ({"Q": lambda c: 60 + 0.4 * np.sin(np.arange(N) / 7)}, "Q does not rise with p1 - p2"),
        ({"t": lambda c: c["t"][::-1]}, "the times run backwards: sort the rows by t"),
        (
            {"t": lambda c: np.random.default_rng(1).permutation(c["t"])},
            "of 6000 samples: sort the rows by t",
        ),
    ],
)
def test_what_cannot_be_is_refused(changes, sentence):
    assert sentence in said(plant(**changes))[Kind.REFUSED]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"U": lambda c: np.clip(c["U"] * 0.18 + 3, 4, 20)}, "is it mA? signals.U.raw = [4, 20]"),
        ({"U": lambda c: np.clip(c["U"] * 0.13 - 1, 0, 10)}, "U runs from 0 to 10 and is cut off"),
        ({"T": lambda c: c["T"] * 1.8 + 32}, "is it °F or K? signals.T.unit"),
        ({"t": lambda c: c["t"] // 20_000_000 * 20_000_000}, "are rows doubled"),
        ({"t": lambda c: c["t"] - 10**12 * (np.arange(N) > 3000)}, "step back 1 times"),
    ],
)
def test_what_may_be_is_a_hint(changes, sentence):
    found = said(plant(**changes))
    assert sentence in found[Kind.HINT]
    assert Kind.REFUSED not in found


def test_a_flow_controller_that_holds_q_is_no_reason_to_doubt_the_pressures():
    dp = 20 + 160 * (0.5 + 0.5 * np.sin(np.arange(N) / 300))
    held = {
        "p1": lambda c: dp + 5,
        "U": lambda c: 6 + 50 / (0.12 * np.sqrt(dp)),
        "Q": lambda c: 50 + np.random.default_rng(2).normal(0, 0.4, N),
    }
    assert findings(plant(**held)) == []


def test_a_pump_that_stands_and_a_closed_valve_say_nothing():
    rng = np.random.default_rng(3)
    noise = lambda c: rng.normal(0, 0.3, N)  # noqa: E731
    assert findings(plant(p1=noise, p2=noise, Q=noise, U=lambda c: 0 * c["U"])) == []
    assert findings(plant(U=lambda c: 0 * c["U"], Q=lambda c: 1 + noise(c))) == []


def refused(samples, parts=1):
    """Which samples are refused (N,), and what is said at the end."""
    plausibility, found = Plausibility(1), []
    for rows in np.array_split(np.arange(len(samples)), parts):
        part = samples[slice(rows[0], rows[-1] + 1)]
        found.append(plausibility.count(part, Segments.one(len(part))))
    return np.concatenate(found), plausibility.findings(0)


def during(first, last, signal, value):
    """Have a signal show something else for some samples."""

    def change(columns):
        changed = columns[signal].copy()
        changed[first:last] = value(columns)[first:last]
        return changed

    return {signal: change}


def test_it_does_not_matter_how_samples_are_cut():
    swapped = during(0, 40, "p1", lambda c: c["p2"]) | during(0, 40, "p2", lambda c: c["p1"])
    for changes in ({"Q": lambda c: -c["Q"]}, swapped):
        samples = plant(**changes)
        whole = refused(samples)
        for parts in (2, 7, 600):
            which, said_then = refused(samples, parts)
            assert (which == whole[0]).all()
            assert said_then == whole[1]


def test_a_spike_at_the_very_start_is_the_gate_s_matter():
    which, found = refused(plant(**during(3, 5, "p2", lambda c: 0 * c["p2"] - 900.0)))
    assert np.flatnonzero(which).tolist() == [3, 4]
    assert found == []


def test_a_sensor_that_failed_for_seconds_is_learnt_from_again_after_ten_times_as_long():
    which, found = refused(plant(**during(100, 200, "p2", lambda c: 0 * c["p2"] - 900.0)))
    assert which[109:1199].all()
    assert not which[1201:].any()
    assert found == []
    failing = plant(n=250, **during(100, 250, "p2", lambda c: 0 * c["p2"][:250] - 900.0))
    (finding,) = refused(failing)[1]
    assert finding.sentence.startswith("a pressure of -900 bar is none of a hydraulic valve: has")


def test_pressures_swapped_for_a_moment_are_learnt_from_soon_and_for_long_later():
    for n, last in ((40, 80), (3_000, 5_000)):
        at_first = during(0, n, "p1", lambda c: c["p2"]) | during(0, n, "p2", lambda c: c["p1"])
        which, found = refused(plant(**at_first))
        assert which[n - 1]
        assert not which[last + 1 :].any()
        assert found == []


def test_pressures_in_psi_that_are_high_in_each_cycle_alone_stay_refused():
    high = 500.0 * (np.arange(N) % 1_000 > 900)
    which, found = refused(plant(p1=lambda c: 100.0 + 0 * c["p1"] + 14.5 * high / 10.0))
    assert which[1_100:].all()
    assert "is it psi?" in found[0].sentence


@pytest.mark.parametrize("most", [10_000, *soaked(30_000)])
@pytest.mark.parametrize("name", list(BUILTIN))
def test_no_built_in_scenario_is_doubted(name, most):
    scenario = BUILTIN[name]
    state, plausibility = initial(scenario, 1_800_000_000_000_000_000), {}
    end = min(scenario.samples or most, most)
    while state.index < end:
        state, block = advance(scenario, state, 1_000)
        for valve, of_valve in block.valves.items():
            columns = {s: getattr(of_valve, s) for s in ("U", "p1", "p2", "Q", "T")}
            samples = Samples.of(t=of_valve.t, **columns)
            plausibility.setdefault(valve, Plausibility(1)).count(
                samples, Segments.one(len(samples))
            )
            assert plausibility[valve].findings(0) == []


def test_no_shipped_recording_is_doubted():
    assert findings(measured_data.cooling_circuit()) == []


def test_one_step_of_the_clock_is_a_hint_however_few_the_samples():
    stepping = plant(n=80, t=lambda c: c["t"] - 10**12 * (np.arange(80) > 30))
    assert list(said(stepping)) == [Kind.HINT]
