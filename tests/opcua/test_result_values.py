from dataclasses import replace

import numpy as np
import pytest
from asyncua import ua

from support.results import results_of
from valvemap.opcua_results.result_values import Shown, columns_of, map_value
from valvemap.pipeline.results import EstimatorResult, InverseResult
from valvemap.vocabulary.statuses import InverseStatus, Quality, Status

T = 1_800_000_000_000_000_000
NOW = T + 5
Codes = ua.StatusCodes

ESTIMATOR = EstimatorResult(
    t=T,
    quality=Quality.GOOD,
    theta=np.array([1.0, 2.0]),
    std=np.array([0.1, 0.2]),
    predicted=50.0,
    residual=0.5,
    residual_rmse=0.4,
    sample_count=9,
    status=Status.OK,
    noise_std=0.3,
    systematic_std=0.2,
)
INVERSE = InverseResult(T, Quality.GOOD, 42.0, int(InverseStatus.OK), np.ones((3, 2)))


def shown(estimator=ESTIMATOR, inverse=INVERSE):
    columns = columns_of(results_of(0, {"RLS": estimator}, inverse), NOW)
    return {c.name: Shown(c.name, c.values[0], c.codes[0], c.t[0]) for c in columns}


def test_a_good_result_is_good_with_the_samples_time():
    assert all((new.code, new.t) == (Codes.Good, T) for new in shown().values())


@pytest.mark.parametrize("status", list(Status))
def test_of_what_is_old_nothing_is_good(status):
    results = results_of(0, {"RLS": replace(ESTIMATOR, status=status)}, INVERSE)
    quality = np.array([Quality.UNCERTAIN], np.uint8)
    old = replace(results.estimators["RLS"], quality=quality, old=np.array([True]))
    columns = columns_of(replace(results, estimators={"RLS": old}), NOW)
    codes = [c.codes[0] for c in columns if c.name.startswith("RLS.")]
    assert len(codes) > 5
    assert not [code for code in codes if code >> 30 == 0]


@pytest.mark.parametrize(
    ("quality", "status", "code"),
    [
        (Quality.GOOD, Status.OK, Codes.Good),
        (Quality.GOOD, Status.FROZEN, Codes.Good),
        (Quality.UNCERTAIN, Status.WARMING_UP, Codes.UncertainInitialValue),
        (Quality.UNCERTAIN, Status.UNEXCITED, Codes.UncertainSubNormal),
        (Quality.UNCERTAIN, Status.HELD, Codes.UncertainLastUsableValue),
        (Quality.BAD, Status.REJECTED, Codes.BadSensorFailure),
        (Quality.BAD, Status.OK, Codes.BadNoCommunication),
        (Quality.BAD, Status.WARMING_UP, Codes.BadNoCommunication),
    ],
)
def test_quality_and_status_make_a_code_that_means_something(quality, status, code):
    found = replace(ESTIMATOR, quality=quality, status=status)
    assert shown(found)["RLS.ParameterVector"].code == code


def test_before_the_first_sample_everything_waits():
    nothing = replace(ESTIMATOR, t=0, quality=Quality.UNCERTAIN, status=Status.WARMING_UP)
    values = shown(nothing, replace(INVERSE, t=0))
    for name in ("RLS.ParameterVector", "RLS.PredictedFlow", "Inverse.RequiredU"):
        assert (values[name].code, values[name].t) == (Codes.BadWaitingForInitialData, NOW)
    assert values["RLS.Status"].code == Codes.UncertainInitialValue


def test_with_lost_sensors_nothing_stays_good_and_the_services_own_words_stay_readable():
    lost = replace(ESTIMATOR, quality=Quality.BAD)
    values = shown(lost, replace(INVERSE, quality=Quality.BAD))
    for name in ("ParameterVector", "ParameterStd", "PredictedFlow", "Residual", "ResidualRmse"):
        assert values[f"RLS.{name}"].code == Codes.BadNoCommunication
    assert values["Inverse.RequiredU"].code == Codes.BadNoCommunication
    for name in ("RLS.SampleCount", "RLS.Status", "Inverse.RequiredUStatus"):
        assert values[name].code == Codes.UncertainLastUsableValue
    assert all(new.t == T for new in values.values())


def test_a_number_that_is_none_is_not_good():
    values = shown(replace(ESTIMATOR, predicted=np.nan, residual=np.nan))
    assert values["RLS.PredictedFlow"].code == Codes.UncertainInitialValue
    assert values["RLS.Residual"].code == Codes.UncertainInitialValue
    assert values["RLS.ParameterVector"].code == Codes.Good


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (InverseStatus.OK, Codes.Good),
        (InverseStatus.ABOVE_REACH, Codes.UncertainEngineeringUnitsExceeded),
        (InverseStatus.BELOW_REACH, Codes.UncertainEngineeringUnitsExceeded),
        (InverseStatus.NOT_MONOTONE, Codes.BadInvalidState),
        (InverseStatus.UNIDENTIFIED, Codes.BadWaitingForInitialData),
        (InverseStatus.NOT_FINITE, Codes.BadNoData),
    ],
)
def test_required_U_is_only_good_where_it_delivers(status, code):
    values = shown(inverse=replace(INVERSE, status=int(status)))
    assert values["Inverse.RequiredU"].code == code
    assert values["Inverse.RequiredUStatus"].value == status
    assert values["Inverse.RequiredUStatus"].code == Codes.Good


def test_the_worse_of_two_reasons_counts():
    lost = replace(INVERSE, quality=Quality.BAD, status=int(InverseStatus.ABOVE_REACH))
    assert shown(inverse=lost)["Inverse.RequiredU"].code == Codes.BadNoCommunication
    poor = replace(INVERSE, quality=Quality.UNCERTAIN, status=int(InverseStatus.NOT_FINITE))
    assert shown(inverse=poor)["Inverse.RequiredU"].code == Codes.BadNoData


def test_a_map_without_a_single_number_is_not_identified():
    empty = replace(INVERSE, map_U=np.full((3, 2), np.nan))
    assert map_value(empty.map_U, Codes.Good, T).code == Codes.BadWaitingForInitialData
    assert map_value(empty.map_U, Codes.BadNoCommunication, T).code == Codes.BadNoCommunication
    assert map_value(INVERSE.map_U, Codes.Good, T).code == Codes.Good
