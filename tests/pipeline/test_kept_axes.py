"""States of axes that earlier versions have stored: without the columns of force and delays."""

from dataclasses import make_dataclass

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_condition import Condition, Reference
from valvemap.model.axis_force import ForceState
from valvemap.model.estimator import State
from valvemap.pipeline import kept_axes, kept_watches
from valvemap.pipeline.axis_watch import AxisWatch, AxisWindowSums
from valvemap.pipeline.kept_axes import NEWER

REGRESSION = AxisRegression(AxisGeometry(63, 45, 800, 1.2, 1.2), play_percent=2.0, spool_hz=40.0)
KEY = "key"
DELAYS = 2


def as_before(kind, packed, version, missing):
    """The same state as a version without the last ``missing`` columns has stored it."""
    arrays = {}
    for name, array in vars(kind.from_bytes(packed, KEY)).items():
        shape = np.shape(array)
        if name == "filtered":
            arrays[name] = np.delete(array, slice(SIZE - missing, SIZE), axis=-1)
        else:
            arrays[name] = array[tuple(slice(n - missing if n == SIZE else n) for n in shape)]
    older = make_dataclass(
        kind.__name__, arrays, bases=(State,), frozen=True, namespace={"state_version": version}
    )
    return older(**arrays).to_bytes(KEY)


def state_without(missing):
    rng, initial = np.random.default_rng(1), REGRESSION.initial_state()
    new = slice(SIZE - missing, SIZE)
    for name in ("M", "b", "theta", "score", "scores", "filtered"):
        array = getattr(initial, name)
        array[...] = rng.uniform(size=array.shape)
    for array in (initial.M, initial.scores):
        array[new], array[:, new] = 0.0, 0.0
    for array in (initial.b, initial.theta, initial.score):
        array[new] = 0.0
    initial.filtered[..., new] = 0.0
    return initial


@pytest.mark.parametrize(("version", "missing"), [(4, len(NEWER)), (5, DELAYS)])
def test_an_axis_stored_without_the_columns_continues(version, missing):
    state = state_without(missing)
    learnt = kept_axes.Learnt(REGRESSION, state, np.zeros((SIZE, SIZE)))
    before = as_before(kept_axes._Kept, kept_axes.pack(learnt, KEY), version, missing)
    read = kept_axes.unpack(before, KEY, REGRESSION)
    for name, array in vars(state).items():
        np.testing.assert_array_equal(getattr(read.state, name), array, name)
    assert read.of_shape.shape == (SIZE, SIZE)


@pytest.mark.parametrize(("version", "missing"), [(2, len(NEWER)), (3, DELAYS)])
def test_a_watch_stored_without_the_columns_knows_nothing_of_them(version, missing):
    state = state_without(missing)
    square = np.zeros((SIZE, SIZE))
    reference = Reference(state.theta, np.eye(SIZE), 1.0, 1.0)
    sums = AxisWindowSums(state, ForceState.initial())
    watch = AxisWatch(REGRESSION, 1800.0, square, reference, sums, sums, Condition.initial())
    packed = kept_watches.pack_watch(watch, KEY)
    before = as_before(kept_watches._KeptWatch, packed, version, missing)
    read = kept_watches.unpack_watch(before, KEY, REGRESSION)
    np.testing.assert_array_equal(read.reference.theta, state.theta)
    np.testing.assert_array_equal(read.sums.flow.M, state.M)
    known = np.diag(read.reference.precision)[-missing:]
    assert known == pytest.approx(np.array(NEWER[-missing:]) ** -2.0)
    assert np.linalg.det(read.reference.precision) > 0.0
