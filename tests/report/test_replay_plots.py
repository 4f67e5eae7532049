from dataclasses import replace

import numpy as np

from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.pipeline.valve_state import fresh_lane
from valvemap.report.replay_plots import ReplayPlots
from valvemap.vocabulary.statuses import Quality

N = 600


def some_samples(quality=Quality.GOOD):
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, N), rng.uniform(0, 200, N)
    Q = 0.1 * U * np.sqrt(dp) + rng.normal(0, 0.1, N)
    t = np.arange(N) * 10_000_000
    return Samples.of(t, U, np.full(N, 200.0), 200 - dp, Q, quality=np.full(N, quality))


def replayed(folder, samples):
    estimator = RecursiveLeastSquares()
    state, trace = estimator.update(estimator.initial_state(), samples)
    lane = replace(fresh_lane(estimator), state=state)
    plots = ReplayPlots(folder)
    plots.take("V1", samples, {"RLS": trace})
    return plots.write({"V1": {"RLS": lane}})


def test_every_valve_gets_its_pictures_and_every_estimator_its_map(tmp_path):
    files = list(replayed(tmp_path / "new", some_samples()))
    assert [file.name for file in files] == [
        "V1-agreement.png",
        "V1-residuals.png",
        "V1-map-RLS.png",
    ]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)


def test_a_valve_without_one_good_sample_has_nothing_to_draw(tmp_path):
    assert list(replayed(tmp_path, some_samples(Quality.BAD))) == []
