import json

import numpy as np
import pytest

from valvemap.errors import StorageError
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive, Exponential
from valvemap.model.inverse_map import invert
from valvemap.model.linear_map import LinearMap
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import Polynomial
from valvemap.model.monotone import Monotone
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Samples
from valvemap.model.support import Support
from valvemap.model.tensor_spline import TensorSpline
from valvemap.storage.models import MOST_BYTES, load_model, save_model
from valvemap.vocabulary.statuses import Quality, Status

ESTIMATORS = {
    "eq. (7)": RecursiveLeastSquares(forgetting=Adaptive()),
    "exponential": RecursiveLeastSquares(forgetting=Exponential(0.99)),
    "polynomial": RecursiveLeastSquares(Polynomial(terms=("s", "U*s", "dp*nu^-1"))),
    "spline": RecursiveLeastSquares(TensorSpline.uniform(6, 4), Adaptive()),
    "kinked spline": RecursiveLeastSquares(
        TensorSpline((0, 30, 100), (0, 7, 15), (20, 60), 8.0, 91.0, at_rest="zero")
    ),
    "radial basis": RecursiveLeastSquares(RadialBasis.uniform(), Adaptive()),
    "rising": Monotone(RecursiveLeastSquares(TensorSpline.uniform(4, 3))),
    "maximum likelihood": MaximumLikelihood(),
    "network": RbfNetwork(),
    "auto": FlowMap(),
}


def recording(n=3000):
    rng = np.random.default_rng(2)
    U, dp, T = rng.uniform(0, 100, n), rng.uniform(1, 200, n), rng.uniform(25, 55, n)
    Q = 2.0 * np.clip(U - 8.0, 0, 80) * np.sqrt(dp / 200) * (1 + 0.001 * (T - 40))
    return Samples.of(np.arange(n), U, dp, 0 * dp, Q + 0.4 * rng.normal(size=n), T)


def taught(estimator):
    samples = recording()
    state, trace = estimator.update(estimator.initial_state(), samples)
    return state, ResidualSpread.none().add(samples, trace), Support.none().add(samples, trace)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_loaded_model_predicts_and_inverts_as_the_saved_one(name, tmp_path):
    estimator = ESTIMATORS[name]
    state, scatter, support = taught(estimator)
    file = tmp_path / "model.json"
    save_model(file, "V1", name, estimator, state, scatter, support, t=7, T=41.5)
    model = load_model(file)
    assert (model.valve, model.name, model.t, model.T) == ("V1", name, 7, 41.5)
    assert model.noise_std == scatter.noise_std
    assert np.array_equal(model.samples, scatter.weights)
    for field in ("cells", "fit", "ranges"):
        np.testing.assert_array_equal(getattr(model.support, field), getattr(support, field))
    rng = np.random.default_rng(3)
    U, dp, T = rng.uniform(0, 100, 200), rng.uniform(1, 200, 200), rng.uniform(25, 55, 200)
    before = estimator.predict(state, U, dp, T)
    after = model.estimator.predict(model.state, U, dp, T)
    np.testing.assert_allclose(after[0], before[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(after[1], before[1], rtol=1e-6)
    Q = rng.uniform(0, 150, 200)
    mine = invert(estimator, state, Q, dp, T, support=support)
    its = invert(model.estimator, model.state, Q, dp, T, support=model.support)
    assert np.array_equal(mine.status, its.status)
    np.testing.assert_allclose(its.U, mine.U, atol=1e-8)
    np.testing.assert_allclose(its.lower, mine.lower, atol=1e-4)


def test_a_file_of_before_has_its_effects_of_temperature_as_those_of_the_logarithm(tmp_path):
    estimator = ESTIMATORS["auto"]
    save_model(tmp_path / "m.json", "V1", "auto", estimator, *taught(estimator))
    document = json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))
    assert document["map"].pop("effects_of") == "logarithm"
    for side in document["map"]["moving"]:
        side[0][-5:] = [0.02, 0.2, -0.1, 0.06, 0.01]  # of ln ν, √ν - 1, ν - 1, √ν - 1, 1/ν - 1
    (tmp_path / "old.json").write_text(json.dumps(document), encoding="utf-8")
    now = load_model(tmp_path / "old.json").state.now
    np.testing.assert_allclose(now[:, 0, 4:9], [[0.02, 0.0, -0.025, 0.03, 0.01]] * 2, atol=1e-12)


def test_the_file_says_what_it_holds_in_physical_units(tmp_path):
    estimator = ESTIMATORS["eq. (7)"]
    state, scatter, support = taught(estimator)
    save_model(tmp_path / "m.json", "V1", "RLS", estimator, state, scatter, support)
    document = json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))
    assert (document["format"], document["version"]) == ("valvemap-model", 2)
    assert document["units"] == {"U": "%", "dp": "bar", "s": "√bar", "Q": "l/min", "T": "°C"}
    assert list(document["parameters"]) == ["a1", "a2", "a3", "a4", "a5"]
    theta, std = estimator.parameters(state)
    assert list(document["parameters"].values()) == theta.tolist()
    np.testing.assert_allclose(np.sqrt(np.diag(document["map"]["covariance"])), std)
    assert np.shape(document["region"]["samples"]) == (10, 12)
    assert document["temperature"] is None


@pytest.mark.parametrize("name", ["eq. (7)", "maximum likelihood", "auto"])
def test_what_is_not_determined_yet_is_not_saved(name, tmp_path):
    estimator = ESTIMATORS[name]
    state = estimator.initial_state()
    nothing = ResidualSpread.none(), Support.none()
    with pytest.raises(StorageError, match=r"m\.json: V1\.X is not saved: .* not determined yet"):
        save_model(tmp_path / "m.json", "V1", "X", estimator, state, *nothing)
    assert not (tmp_path / "m.json").exists()


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("version", 1, r"version: Input should be 2, not 1"),
        ("support.fit", [1.0], r"support\.fit: .* at least 225 items"),
        ("support.Q_max", 0.0, r"support\.Q_max: .* greater than 0, not 0\.0"),
        ("support.dp_range", [9.0, 9.0], r"support: dp_range: two ascending numbers are allowed"),
        ("support.boxes", [[1.0]], r"support: boxes: rows of 9 numbers are allowed"),
        ("format", "other", r"format: Input should be 'valvemap-model', not 'other'"),
        ("units", {"U": "V"}, r"units are \{'U': 'V'\}; .* is allowed"),
        ("noise_std", "much", r"noise_std: .* not 'much'"),
        ("noise_std", -1, r"noise_std: .*greater than or equal to 0, not -1"),
        ("extra", 1, r"extra: Extra inputs are not permitted"),
        ("map.theta", [1.0], r"map: theta has 1 numbers; 5 are allowed"),
        ("map.covariance", [[1.0]], r"map: covariance: 5 rows of 5 numbers are allowed"),
        ("map.structure.terms", ["U^x"], r"map.*U\^x"),
        ("map.kind", "magic", r"map: .*linear"),
        ("map.theta", [1e999] * 5, r"map\.theta\.0: .* finite"),
        ("map.theta", [10**400] * 5, r"map\.theta\.0: .* valid number, not 10{59}$"),
        ("region.samples", [[1.0], [1.0, 2.0]], r"region: samples: 10 rows of 12 numbers"),
        (
            "map.structure",
            {"kind": "spline", "U": list(range(3_000)), "s": list(range(3_000))},
            r"map: theta has 5 numbers; 9000000 or more are allowed",
        ),
    ],
)
def test_a_mistake_in_a_model_is_one_line_with_file_field_and_what_is_allowed(
    field, value, sentence, tmp_path
):
    file = tmp_path / "m.json"
    estimator = ESTIMATORS["eq. (7)"]
    save_model(file, "V1", "RLS", estimator, *taught(estimator))
    document = json.loads(file.read_text(encoding="utf-8"))
    *path, last = field.split(".")
    place = document
    for key in path:
        place = place[key]
    place[last] = value
    file.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(StorageError, match=sentence) as raised:
        load_model(file)
    assert str(raised.value).startswith(f"{file}: ")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b"null"])
def test_what_is_no_model_is_refused_in_one_line(content, tmp_path):
    file = tmp_path / "m.json"
    file.write_bytes(content)
    with pytest.raises(StorageError, match=r"m\.json: ") as raised:
        load_model(file)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("depth", [9, 500, 200_000])
@pytest.mark.parametrize("level", [("[", "]"), ('{"a":', "}"), ("[", "")])
def test_a_file_that_is_nested_too_deep_is_refused_in_one_line(level, depth, tmp_path):
    file = tmp_path / "m.json"
    opening, closing = level
    file.write_text(opening * depth + "1" + closing * depth, encoding="utf-8")
    with pytest.raises(
        StorageError, match=r"m\.json: (nested too deep; 8 levels|not JSON)"
    ) as said:
        load_model(file)
    assert len(str(said.value)) < 300


def test_a_file_that_is_too_large_is_refused_before_it_is_read_whole(tmp_path):
    file = tmp_path / "m.json"
    with file.open("wb") as sparse:
        sparse.truncate(100 * MOST_BYTES)
    with pytest.raises(StorageError, match=r"m\.json: it is too large; up to 64 MB are allowed"):
        load_model(file)


def test_a_file_that_cannot_be_written_or_read_is_named(tmp_path):
    estimator = ESTIMATORS["eq. (7)"]
    with pytest.raises(StorageError, match=r"nowhere"):
        save_model(tmp_path / "nowhere" / "m.json", "V", "R", estimator, *taught(estimator))
    with pytest.raises(StorageError, match=r"m\.json: no such file"):
        load_model(tmp_path / "m.json")


def test_a_loaded_map_never_learns(tmp_path):
    estimator = ESTIMATORS["eq. (7)"]
    state, scatter, support = taught(estimator)
    save_model(tmp_path / "m.json", "V", "R", estimator, state, scatter, support)
    model = load_model(tmp_path / "m.json")
    assert isinstance(model.estimator, LinearMap)
    samples = recording(10)
    samples.quality[3] = Quality.BAD
    after, trace = model.estimator.update(model.state, samples)
    assert after is model.state
    assert trace.status.tolist() == [Status.FROZEN] * 3 + [Status.REJECTED] + [Status.FROZEN] * 6
    assert np.isnan(model.estimator.initial_state().theta).all()
