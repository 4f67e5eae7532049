"""What every estimator keeps to, whatever its method: the table is in conftest.py."""

import io
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvemap.model.estimator import StateMismatchError, key_of
from valvemap.model.samples import Samples
from valvemap.vocabulary.statuses import Quality, Status

USED = (Status.OK, Status.WARMING_UP, Status.UNEXCITED)
ABSURD = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200)


def valve(N, seed=0, noise=1.0):
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(0, 200, N)
    Q = 0.13 * U * np.sqrt(dp) - 0.02 * dp + noise * rng.normal(size=N)
    t, p1, T = 1_000_000 * np.arange(N), np.full(N, 200.0), np.full(N, 40.0)
    return Samples.of(t, U, p1, p1 - dp, Q, T)


def constant(N, U=50.0, p1=200.0, p2=100.0, Q=65.0):
    return Samples.of(np.arange(N), *(np.full(N, value) for value in (U, p1, p2, Q, 40.0)))


def arrays(state):
    return {f.name: np.asarray(getattr(state, f.name)) for f in fields(state)}


def assert_same(a, b):
    for name, array in arrays(a).items():
        np.testing.assert_array_equal(array, arrays(b)[name], err_msg=name, strict=True)


def run(estimator, samples, cuts=()):
    state, traces = estimator.initial_state(), []
    for start, stop in zip((0, *cuts), (*cuts, len(samples)), strict=True):
        state, trace = estimator.update(state, samples[start:stop])
        traces.append(trace)
    joined = [
        np.concatenate([getattr(trace, name) for trace in traces])
        for name in ("predicted", "residual", "status")
    ]
    return state, joined


def is_sane(state):
    """Finite, but for NaN that stands for 'never seen' from the beginning."""
    return all(
        not np.isinf(array).any() for array in arrays(state).values() if array.dtype.kind == "f"
    )


def test_it_learns_the_valve_and_says_what_it_says_of_each_sample(estimator):
    samples = valve(3000)
    state, (predicted, residual, status) = run(estimator, samples)
    known = np.isfinite(residual)
    np.testing.assert_array_equal(residual[known], (samples.Q - predicted)[known])
    assert known[-1000:].all()
    assert set(status.tolist()) <= set(USED)
    theta, std = estimator.parameters(state)
    assert theta.shape == std.shape == (len(estimator.parameter_names),)
    assert np.isfinite(theta).all()
    Q, std = estimator.predict(state, samples.U[:50], samples.dp[:50], samples.T[:50])
    assert Q.shape == std.shape == (50,)
    assert np.isfinite(Q).all()
    assert np.sqrt(np.mean(residual[-1000:] ** 2)) < 12.0
    assert is_sane(state)


def test_it_changes_none_of_its_arguments(estimator):
    """Told by bits: arrays that cannot be written are another type to numba, compiled anew."""
    samples = valve(200)
    state, _ = run(estimator, samples)
    given = [getattr(samples, name) for name in ("t", "U", "p1", "p2", "Q", "T", "quality")]
    given += arrays(state).values()
    before = [array.tobytes() for array in given]
    after, _ = estimator.update(state, samples)
    estimator.predict(after, samples.U, samples.dp, samples.T)
    estimator.parameters(after)
    assert [array.tobytes() for array in given] == before


@pytest.mark.parametrize("seed", range(3))
def test_a_stream_cut_into_other_batches_gives_the_same_bits(estimator, seed):
    rng = np.random.default_rng(seed)
    samples = valve(700, seed)
    samples.Q[rng.integers(0, 700, 20)] = np.nan
    whole, traces = run(estimator, samples)
    cuts = np.unique(rng.integers(0, 701, 30))
    parts, traces_of_parts = run(estimator, samples, cuts)
    assert_same(whole, parts)
    for a, b in zip(traces, traces_of_parts, strict=True):
        np.testing.assert_array_equal(a, b, strict=True)
    singles, traces_of_singles = run(estimator, samples[:150], range(1, 150))
    assert_same(run(estimator, samples[:150])[0], singles)
    np.testing.assert_array_equal(traces_of_singles[0], traces[0][:150])


def test_one_point_is_predicted_like_many_to_the_bit(estimator):
    samples = valve(500)
    state, _ = run(estimator, samples)
    Q, std = estimator.predict(state, samples.U, samples.dp, samples.T)
    for i in range(0, 500, 61):
        one = slice(i, i + 1)
        alone = estimator.predict(state, samples.U[one], samples.dp[one], samples.T[one])
        np.testing.assert_array_equal(alone, [Q[one], std[one]])


def test_resumed_from_bytes_it_goes_on_as_if_never_interrupted(estimator):
    samples, key = valve(600), key_of(estimator)
    first, _ = estimator.update(estimator.initial_state(), samples[:300])
    restored = type(first).from_bytes(first.to_bytes(key), key)
    assert_same(first, restored)
    uninterrupted, trace = estimator.update(first, samples[300:])
    resumed, resumed_trace = estimator.update(restored, samples[300:])
    assert_same(uninterrupted, resumed)
    np.testing.assert_array_equal(trace.residual, resumed_trace.residual)
    with pytest.raises(StateMismatchError):
        type(first).from_bytes(first.to_bytes(key), "another")


def test_a_state_of_an_earlier_version_is_refused(estimator, monkeypatch):
    state = estimator.initial_state()
    of_today = state.to_bytes("key")
    monkeypatch.setattr(type(state), "state_version", type(state).state_version + 1)
    with pytest.raises(StateMismatchError, match="state of"):
        type(state).from_bytes(of_today, "key")


def test_a_state_whose_texts_are_none_is_refused(estimator):
    state = estimator.initial_state()
    packed, name = state.to_bytes("key"), type(state).__name__.encode("utf-32-le")
    assert packed.count(name) == 1
    damaged = packed.replace(name, b"\xff" * 4 + name[4:])  # no code point
    with pytest.raises(StateMismatchError, match="no text"):
        type(state).from_bytes(damaged, "key")


def test_its_bytes_are_what_numpy_writes(estimator):
    state = run(estimator, valve(100))[0]
    ours, written = state.to_bytes("key"), io.BytesIO()
    np.save(written, np.load(io.BytesIO(ours), allow_pickle=False), allow_pickle=False)
    assert written.getvalue() == ours


def test_its_state_is_of_constant_size(estimator):
    sizes = [
        {name: (array.shape, array.dtype) for name, array in arrays(state).items()}
        for state in (run(estimator, valve(N))[0] for N in (0, 1, 100, 2000))
    ]
    assert all(size == sizes[0] for size in sizes)


def test_unusable_samples_leave_the_state_untouched(estimator):
    state, _ = run(estimator, valve(300))
    samples = constant(4 * len(ABSURD) + 1)
    for column, name in enumerate(("U", "p1", "p2", "Q")):
        getattr(samples, name)[column * len(ABSURD) : (column + 1) * len(ABSURD)] = ABSURD
    samples.quality[-1] = Quality.BAD
    after, trace = estimator.update(state, samples)
    assert_same(after, state)
    assert set(trace.status.tolist()) <= {Status.REJECTED, Status.HELD}
    # So do they at the very beginning.
    fresh, _ = estimator.update(estimator.initial_state(), samples)
    assert_same(fresh, estimator.initial_state())


def test_nothing_it_is_asked_makes_it_raise_or_warn(estimator):
    state, _ = run(estimator, valve(300))
    for point in ABSURD:
        at = np.array([point, 50.0, 50.0, 50.0])
        for known in (state, estimator.initial_state()):
            Q, std = estimator.predict(known, at, np.roll(at, 1), np.roll(at, 2))
            assert Q.shape == std.shape == (4,)
            assert not np.isinf(Q).any()


@pytest.mark.parametrize(
    "dull",
    [
        constant(2000),
        constant(2000, U=0.0, p2=200.0, Q=0.0),
        constant(2000, U=0.0, p1=0.0, p2=0.0, Q=0.0),
        constant(2000, U=1e-300, p2=200.0, Q=1e-300),
    ],
    ids=["a point", "closed", "zero", "denormal"],
)
def test_it_survives_signals_without_news_and_learns_afterwards(estimator, dull):
    state, _ = run(estimator, dull)
    assert is_sane(state)
    again, _ = estimator.update(state, valve(3000, 5))
    _, trace = estimator.update(again, valve(500, 6))
    assert set(trace.status.tolist()) <= set(USED)
    assert np.sqrt(np.mean(trace.residual**2)) < 12.0
    # What was learnt is not lost to dull signals afterwards.
    after, _ = estimator.update(again, dull)
    assert is_sane(after)
    assert np.isfinite(estimator.parameters(after)[0]).all()


def test_no_sample_is_a_sample_too_few_and_no_error(estimator):
    state, trace = estimator.update(estimator.initial_state(), Samples.empty())
    assert len(trace) == 0
    assert_same(state, estimator.initial_state())
    Q, _ = estimator.predict(state, np.empty(0), np.empty(0), np.empty(0))
    assert len(Q) == 0


def test_the_key_names_its_hyper_parameters(estimator):
    assert key_of(estimator) == key_of(replace(estimator))
    if hasattr(estimator, "with_forgetting") and "SlidingWindow" not in repr(estimator):
        assert key_of(estimator) != key_of(estimator.with_forgetting(0.97))


CANNOT_BE = (np.nan, np.inf, -np.inf, -1.0, -1e300, 1e300, 2.0**62, 2.5, 0.0, 1e6)


def hurt(state, data):
    """The same state with one number changed; None where the type cannot hold it."""
    name = data.draw(st.sampled_from([n for n, a in arrays(state).items() if a.size]))
    array = arrays(state)[name].copy()
    place = data.draw(st.integers(0, array.size - 1))
    number = data.draw(st.sampled_from(CANNOT_BE))
    if array.dtype.kind in "iu":
        limits = np.iinfo(array.dtype)
        whole = 0 if np.isnan(number) else int(np.clip(number, -(2.0**62), 2.0**62))
        number = max(int(limits.min), min(whole, int(limits.max)))
    with np.errstate(over="ignore"):
        array.reshape(-1)[place] = number
    return replace(state, **{name: array})


@st.composite
def circumstances(draw):
    """Samples of any valve, good and absurd, scattered and at rest."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    N, scale = draw(st.sampled_from((40, 400, 1500))), draw(st.sampled_from((0.0, 1e-6, 1.0, 1e4)))
    samples = valve(N, int(rng.integers(1000)), draw(st.sampled_from((0.0, 1.0, 30.0))))
    if draw(st.booleans()):  # levels, one after another
        for name in ("U", "p2"):
            signal = getattr(samples, name)
            signal[:] = np.repeat(signal[::25], 25)[:N]
    samples.Q[:] *= scale
    for name in ("U", "p1", "Q", "T"):
        where = rng.integers(0, N, draw(st.sampled_from((0, 3))))
        getattr(samples, name)[where] = rng.choice(ABSURD, len(where))
    return samples


@pytest.mark.parametrize("cases", [4, pytest.param(300, marks=pytest.mark.soak)])
def test_whatever_it_has_learnt_can_be(estimator, cases):
    fresh = estimator.initial_state()

    @settings(max_examples=cases)
    @given(circumstances())
    def holds(samples):
        state = fresh
        for part in np.array_split(np.arange(len(samples)), 5):
            state, _ = estimator.update(state, samples[part])
            state.check(fresh)

    holds()


@pytest.mark.parametrize("cases", [20, pytest.param(2000, marks=pytest.mark.soak)])
def test_a_state_that_cannot_be_is_refused_or_does_no_harm(estimator, cases):
    fresh, samples = estimator.initial_state(), valve(300, seed=8)
    learnt, _ = run(estimator, valve(900, seed=7))

    @settings(max_examples=cases)
    @given(st.data())
    def holds(data):
        state = hurt(learnt, data)
        try:
            state.check(fresh)
        except StateMismatchError:
            return
        with np.errstate(all="ignore"):
            after, trace = estimator.update(state, samples[:100])
            theta, std = estimator.parameters(after)
            Q, _ = estimator.predict(after, samples.U, samples.dp, samples.T)
        assert theta.shape == std.shape == (len(estimator.parameter_names),)
        assert len(trace.predicted) == 100
        assert Q.shape == samples.U.shape

    holds()


def test_a_state_without_numbers_or_of_another_size_is_refused(estimator):
    fresh = estimator.initial_state()
    learnt, _ = run(estimator, valve(300))
    for name, array in arrays(learnt).items():
        if not array.size:
            continue
        wrong = [np.delete(array, 0, axis=0) if array.ndim else array[None], array.astype(complex)]
        if array.dtype.kind == "f":
            wrong.append(np.full_like(array, np.inf))
        for other in wrong:
            with pytest.raises(StateMismatchError, match=name):
                replace(learnt, **{name: other}).check(fresh)
