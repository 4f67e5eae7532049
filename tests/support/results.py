"""Results of one valve, as the results server takes them."""

from dataclasses import fields

import numpy as np

from guarded_opcua import ServerSettings
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.pipeline.results import (
    EstimatorResult,
    EstimatorResults,
    InverseResult,
    InverseResults,
    Results,
)
from valvemap.vocabulary.statuses import Quality, Status

ESTIMATOR = EstimatorResult(
    t=1_000,
    quality=Quality.GOOD,
    theta=np.array([1.0, -2.5]),
    std=np.array([0.1, 0.2]),
    predicted=50.0,
    residual=0.5,
    residual_rmse=0.4,
    sample_count=7,
    status=Status.OK,
    noise_std=0.3,
)
INVERSE = InverseResult(1_000, Quality.GOOD, 42.0, 0, np.zeros((1, 1)))


def results_of(valve, estimators, inverse, signals=None, waiting=(), **counters):
    """Results of valve number ``valve`` from what there is of each of its estimators."""
    return Results(
        valves=np.array([valve]),
        estimators={n: _arrays(EstimatorResults, e) for n, e in estimators.items()},
        inverse=_arrays(InverseResults, inverse),
        counters=np.array([list(counters.values())], np.int64).reshape(1, -1),
        counter_names=tuple(counters),
        signals=signals,
        waiting=waiting,
    )


def results_settings(**more):
    """Settings of a results server on a free port."""
    return ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/service/",
        application_uri="urn:test:service",
        application_name="service",
        namespace_uri=NAMESPACE,
        **more,
    )


def _arrays(kind, one):
    lists = {"survey", "change", "structure", "lags", "map_U"}
    types = {"quality": np.uint8, "status": np.uint8, "adaptation": np.uint8}
    return kind(
        **{
            f.name: [value] if f.name in lists else np.array([value], types.get(f.name))
            for f in fields(kind)
            if f.name != "old"  # known of many at once only
            for value in [getattr(one, f.name)]
        }
    )
