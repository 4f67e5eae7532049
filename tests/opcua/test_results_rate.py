"""Single variables at a rate of their own, the frame with every result."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from asyncua import ua

from support.clocks import TurnedClock
from support.results import results_of, results_settings
from support.served import patient
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.results import (
    EstimatorDescription,
    EstimatorResult,
    InverseResult,
    ValveDescription,
)
from valvemap.vocabulary.statuses import Quality, Status

T = 1_800_000_000_000_000_000
VALVE = ValveDescription(
    "V1", (EstimatorDescription("RLS", "", ("a",), has_forgetting_factor=True),), counters=("late",)
)
RESULT = EstimatorResult(
    t=T,
    quality=Quality.GOOD,
    theta=np.array([1.0]),
    std=np.array([0.1]),
    predicted=50.0,
    residual=0.5,
    residual_rmse=0.4,
    sample_count=1,
    status=Status.OK,
    noise_std=0.3,
)
INVERSE = InverseResult(T, Quality.GOOD, 42.0, 0, np.zeros((0, 0)))


@pytest.fixture
def clock():
    return TurnedClock(T)


@pytest.fixture
async def server(clock):
    settings = results_settings(none_on_loopback=True)
    operator = Mock(**{"alarms.return_value": ()})
    async with ResultsServer(settings, [VALVE], operator, clock, scalars_interval_s=1.0) as server:
        yield server


async def test_scalars_wait_for_their_time_and_the_frame_never_does(server, clock):
    async with patient(server.url) as client:
        index = await client.get_namespace_index(NAMESPACE)

        async def shown(name):
            node = client.get_node(ua.NodeId(f"V1.{name}", index))
            return (await node.read_data_value(raise_on_bad_status=False)).Value.Value

        async def publish(k, quality=Quality.GOOD):
            result = replace(RESULT, sample_count=k, quality=quality)
            await server.publish(results_of(0, {"RLS": result}, INVERSE, late=k))
            return [await shown(name) for name in ("RLS.SampleCount", "Diagnostics.Late", "Frame")]

        *scalars, frame = await publish(1)
        assert scalars == [1, 1]
        clock.advance(0.5)
        *scalars, frame = await publish(2)
        assert scalars == [1, 1]
        assert (frame[0], frame[5]) == (2, 2)
        clock.advance(0.5)
        assert (await publish(2))[:2] == [2, 2]
        *scalars, _ = await publish(3, Quality.BAD)
        assert scalars == [3, 3]
