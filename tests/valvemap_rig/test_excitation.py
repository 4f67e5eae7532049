import numpy as np
import pytest

from valvemap_rig.excitation import (
    Cycle,
    External,
    Scattered,
    Structured,
    Verification,
    drive,
)

RATE, P0, SEED = 100.0, 200.0, 3


def driven(excitation, n, start=0, external_U=0.0, valve="Valvistor"):
    return drive(excitation, np.arange(start, start + n), RATE, P0, SEED, valve, external_U)


def test_structured_data_step_u_and_sweep_p2_down_and_up_at_each_step():
    U, p2 = driven(Structured(), 22_000)
    assert np.unique(U).tolist() == list(range(0, 101, 10))
    one = p2[U == 50]
    assert one[0] == 200
    assert one[1000] == 0
    assert (np.diff(one[:1001]) < 0).all()
    assert (np.diff(one[1000:]) > 0).all()
    assert (np.diff(U) >= 0).all()


def test_structured_data_begin_anew_after_the_last_step():
    U, _ = driven(Structured(), 1, start=22_000)
    assert U[0] == 0


def test_scattered_data_cover_signal_and_pressure_drop_evenly():
    U, p2 = driven(Scattered(), 20_000)
    counts, *_ = np.histogram2d(U, P0 - p2, bins=5, range=[[0, 100], [0, 200]])
    assert counts.sum() == 20_000
    assert counts == pytest.approx(np.full((5, 5), 800), rel=0.15)


def test_scattered_points_can_be_held():
    U, p2 = driven(Scattered(hold_s=0.05), 1000)
    assert (U.reshape(-1, 5) == U[::5, None]).all()
    assert (p2.reshape(-1, 5) == p2[::5, None]).all()
    assert len(np.unique(U)) == 200


def test_two_valves_get_points_of_their_own():
    assert not np.array_equal(driven(Scattered(), 50)[0], driven(Scattered(), 50, valve="B")[0])


def test_verification_points_are_in_neither_of_the_others():
    U, p2 = driven(Verification(), 1000)
    assert not np.isin(U, Structured().levels_percent).any()
    V, q2 = driven(Scattered(), 100_000)
    assert not np.isin(U, V).any()
    assert not np.isin(p2, q2).any()


def test_verification_points_cover_the_map_evenly_and_repeat():
    U, p2 = driven(Verification(points=500), 1000)
    counts, *_ = np.histogram2d(U[:500], P0 - p2[:500], bins=5, range=[[0, 100], [0, 200]])
    assert counts == pytest.approx(np.full((5, 5), 20), abs=4)
    assert np.array_equal(U[:500], U[500:])


def test_a_cycle_comes_back_a_little_different():
    U, p2 = driven(Cycle(), 4000)
    assert np.array_equal(p2[:2000], p2[2000:])
    assert not np.array_equal(U[:2000], U[2000:])
    assert U[2000:].max() == pytest.approx(U[:2000].max(), rel=0.11)
    assert np.abs(np.diff(U)).max() < 2  # no jumps: a machine is moved by hand
    assert np.abs(np.diff(p2)).max() < 2.5


def test_a_cycle_without_variation_repeats():
    U, _ = driven(Cycle(variation=0), 4000)
    assert np.array_equal(U[:2000], U[2000:])


def test_external_holds_the_commanded_signal_against_a_swept_load():
    U, p2 = driven(External(p2_low_bar=20, p2_high_bar=180), 2000, external_U=33.0)
    assert (U == 33).all()
    assert (p2.min(), p2.max()) == (20, 180)


@pytest.mark.parametrize("excitation", [Structured(), Scattered(), Verification(), Cycle()])
def test_any_part_can_be_computed_by_itself(excitation):
    whole_U, whole_p2 = driven(excitation, 5000)
    part_U, part_p2 = driven(excitation, 100, start=4321)
    assert part_U.tobytes() == whole_U[4321:4421].tobytes()
    assert part_p2.tobytes() == whole_p2[4321:4421].tobytes()


@pytest.mark.parametrize(
    "excitation", [Structured(), Scattered(), Verification(), Cycle(), External()]
)
def test_no_samples_are_no_trouble(excitation):
    U, p2 = driven(excitation, 0)
    assert len(U) == len(p2) == 0
