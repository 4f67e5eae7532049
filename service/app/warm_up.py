"""Compiling every kernel ahead, so that no sample waits for a compiler."""

import numpy as np

from service.app.build import build_identification
from service.config.models import Config
from service.identification.samples import Samples
from service.opcua.decoding import decode_data_changes
from service.streaming.data_changes import DataChanges

_NO_CHANGES = bytes(4) + b"\xff" * 4  # a DataChangeNotification: no items, no diagnostics
_ONE_CHANGE = DataChanges(
    item=np.zeros(1, np.int32),
    value=np.zeros(1),
    status=np.zeros(1, np.uint32),
    source_time=np.zeros(1, np.int64),
)


def warm_up(config: Config) -> None:
    """Run every kind of pipeline once on made-up samples; nothing of it is kept.

    The first run on a machine compiles for some seconds and caches the result on disk; later runs
    load it.
    """
    decode_data_changes(_NO_CHANGES)
    identification = build_identification(config)
    identification.take(_ONE_CHANGE)
    n = 32
    k = np.arange(n, dtype=np.float64)
    U, dp = (37.0 * k) % 100.0, (1.0 + 61.0 * k) % 200.0
    samples = Samples.of(
        t=np.arange(n), U=U, p1=np.full(n, 200.0), p2=200.0 - dp, Q=U * np.sqrt(dp) / 10, T=0 * U
    )
    for valve in identification.one_of_each_kind():
        plan = identification.plans[valve]
        identification.take_samples(valve, samples)
        for estimator in plan.estimators:
            identification.predict(plan.name, estimator, 50.0, 100.0, 40.0)
        identification.result(valve)
    identification.refresh_maps()
