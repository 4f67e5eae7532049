"""One row per quantity: each is a field of the results, and its kind converts."""

from dataclasses import fields

import numpy as np
import pytest

from valvemap.pipeline.results import EstimatorResult, EstimatorResults
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, FRAME_QUANTITIES, Kind
from valvemap.vocabulary.statuses import Status


@pytest.mark.parametrize("quantity", ESTIMATOR_QUANTITIES, ids=lambda quantity: quantity.name)
def test_a_row_names_a_field_of_one_result_and_of_many(quantity):
    for kind in (EstimatorResult, EstimatorResults):
        assert quantity.field in {field.name for field in fields(kind)}


def test_names_fields_and_series_are_unique():
    for values in (
        [quantity.name for quantity in ESTIMATOR_QUANTITIES],
        [quantity.field for quantity in ESTIMATOR_QUANTITIES],
        [quantity.series for quantity in ESTIMATOR_QUANTITIES if quantity.series],
    ):
        assert len(set(values)) == len(values)


def test_a_code_has_an_enumeration_and_nothing_else_has():
    for quantity in ESTIMATOR_QUANTITIES:
        assert (quantity.kind is Kind.CODE) == (quantity.statuses is not None)


def test_an_element_becomes_a_plain_value_or_a_member():
    of = {quantity.name: quantity for quantity in ESTIMATOR_QUANTITIES}
    assert of["Status"].one(np.uint8(2)) is Status.UNEXCITED
    assert type(of["SampleCount"].one(np.int64(3))) is int
    assert type(of["Residual"].one(np.float64(0.5))) is float


def test_the_frame_keeps_the_order_that_clients_rely_on():
    assert [quantity.name for quantity in FRAME_QUANTITIES] == [
        *("PredictedFlow", "Residual", "ResidualRmse", "NoiseStd", "SampleCount", "Status")
    ]
