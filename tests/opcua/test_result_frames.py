"""All numbers of a valve in one array."""

from dataclasses import replace

import numpy as np
from asyncua import ua

from support.results import ESTIMATOR, INVERSE, results_of
from valvemap.opcua_results.result_frames import frame_names, frame_variables, frames
from valvemap.pipeline.results import EstimatorDescription, SignalResults, ValveDescription
from valvemap.vocabulary.statuses import Quality

VALVE = ValveDescription(
    "V1",
    (
        EstimatorDescription("RLS", "", ("a1", "a2"), has_forgetting_factor=True),
        EstimatorDescription("Auto", "", (), has_forgetting_factor=True),
    ),
)
OTHER = replace(ESTIMATOR, theta=np.empty(0), std=np.empty(0))


SIGNALS = SignalResults(
    np.array([1_000]),
    np.array([Quality.GOOD], np.uint8),
    np.array([[30.0, 150.0, 50.0, 49.0, 100.0, np.nan]]),
)


def columns(signals=SIGNALS, **estimators):
    shown = frames(VALVE, results_of(0, estimators, INVERSE, signals), np.array([3]), 9_999)
    return dict(zip(frame_names(VALVE), shown.values[0].tolist(), strict=True)), shown


def test_a_frame_holds_every_number_under_its_name():
    found, shown = columns(RLS=ESTIMATOR, Auto=OTHER)
    assert found["Sequence"] == 3
    assert found["RLS.PredictedFlow"] == 50.0
    assert found["RLS.SampleCount"] == 7
    assert found["RLS.ParameterVector.a2"] == -2.5
    assert found["Inverse.RequiredU"] == 42.0
    assert (found["Signals.U"], found["Signals.dp"], found["Signals.Q"]) == (30.0, 100.0, 49.0)
    assert (shown.name, shown.t[0], shown.codes[0]) == ("Frame", 1_000, ua.StatusCodes.Good)


def test_the_variables_say_how_long_a_frame_is():
    of_frame, of_names = frame_variables(VALVE)
    assert of_frame.dimensions == of_names.dimensions == (len(frame_names(VALVE)),)


def test_what_is_not_known_is_nan_and_makes_no_good_frame():
    found, shown = columns(RLS=ESTIMATOR)
    assert np.isnan(found["Auto.Residual"])
    found, shown = columns(RLS=replace(ESTIMATOR, quality=Quality.BAD), Auto=OTHER)
    assert shown.codes[0] == ua.StatusCodes.UncertainLastUsableValue


def test_signals_of_lost_sensors_are_no_numbers():
    lost = replace(SIGNALS, quality=np.array([Quality.BAD], np.uint8))
    for signals in (lost, None, replace(SIGNALS, t=np.array([0]))):
        found, _ = columns(signals, RLS=ESTIMATOR, Auto=OTHER)
        assert np.isnan(found["Signals.U"]), signals
