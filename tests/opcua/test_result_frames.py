"""All numbers of a valve in one array."""

import numpy as np
from asyncua import ua

from service.identification.samples import Quality, Status
from service.opcua.result_frames import frame, frame_names, frame_variables
from service.streaming.ports import (
    EstimatorDescription,
    EstimatorResult,
    InverseResult,
    ValveDescription,
    ValveResult,
)

VALVE = ValveDescription(
    "V1",
    (
        EstimatorDescription("RLS", "", ("a1", "a2"), has_forgetting_factor=True),
        EstimatorDescription("Auto", "", (), has_forgetting_factor=True),
    ),
)
ESTIMATOR = EstimatorResult(
    t=1_000,
    quality=Quality.GOOD,
    parameter_names=("a1", "a2"),
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


def columns(**estimators):
    shown = frame(VALVE, ValveResult("V1", estimators, INVERSE, {}), 3, 9_999)
    return dict(zip(frame_names(VALVE), shown.value.tolist(), strict=True)), shown


def test_a_frame_holds_every_number_under_its_name():
    found, shown = columns(RLS=ESTIMATOR, Auto=ESTIMATOR)
    assert found["Sequence"] == 3
    assert found["RLS.PredictedFlow"] == 50.0
    assert found["RLS.SampleCount"] == 7
    assert found["RLS.ParameterVector.a2"] == -2.5
    assert found["Inverse.RequiredU"] == 42.0
    assert (shown.id, shown.t, shown.code) == ("V1.Frame", 1_000, ua.StatusCodes.Good)


def test_the_variables_say_how_long_a_frame_is():
    of_frame, of_names = frame_variables(VALVE)
    assert of_frame.dimensions == of_names.dimensions == (len(frame_names(VALVE)),)


def test_what_is_not_known_is_nan_and_makes_no_good_frame():
    found, shown = columns(RLS=ESTIMATOR)
    assert np.isnan(found["Auto.Residual"])
    other = EstimatorResult(
        **{**vars(ESTIMATOR), "parameter_names": ("b",), "quality": Quality.BAD}
    )
    found, shown = columns(RLS=other, Auto=ESTIMATOR)
    assert np.isnan(found["RLS.ParameterVector.a1"])
    assert shown.code == ua.StatusCodes.UncertainLastUsableValue
