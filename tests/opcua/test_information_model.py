import numpy as np
import pytest
from asyncua import ua

from guarded_opcua import Unit
from valvemap.errors import ConfigurationError
from valvemap.opcua_results.information_model import axis, estimator_variables
from valvemap.opcua_results.map_variables import inverse_variables, map_variable
from valvemap.opcua_results.node_names import check_names
from valvemap.opcua_results.valve_variables import counter_variable
from valvemap.pipeline.results import EstimatorDescription, ValveDescription
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import Adaptation, InverseStatus, Status

RLS = EstimatorDescription(
    "RLS", "Recursive least squares.", ("a1", "a2"), has_forgetting_factor=True
)
VALVE = ValveDescription(
    "Valvistor", (RLS,), (0.0, 200.0), (0.0, 150.0), (0.0, 100.0, 200.0), (50.0, 100.0)
)


def by_name(nodes):
    return {node.id.rpartition(".")[2]: node for node in nodes}


def test_an_estimators_node_ids_are_the_contracts():
    names = [node.id for node in estimator_variables(VALVE, RLS)]
    assert names == [
        "Valvistor.RLS.ParameterVector",
        "Valvistor.RLS.ParameterStd",
        "Valvistor.RLS.ParameterNames",
        "Valvistor.RLS.PredictedFlow",
        "Valvistor.RLS.Residual",
        "Valvistor.RLS.ResidualRmse",
        "Valvistor.RLS.NoiseStd",
        "Valvistor.RLS.SystematicStd",
        "Valvistor.RLS.SampleCount",
        "Valvistor.RLS.Status",
        "Valvistor.RLS.Adaptation",
    ]


def test_an_estimators_types_are_the_contracts():
    kinds = {name: n.kind.name for name, n in by_name(estimator_variables(VALVE, RLS)).items()}
    assert kinds == {
        "ParameterVector": "Double",
        "ParameterStd": "Double",
        "ParameterNames": "String",
        "PredictedFlow": "Double",
        "Residual": "Double",
        "ResidualRmse": "Double",
        "NoiseStd": "Double",
        "SystematicStd": "Double",
        "SampleCount": "UInt64",
        "Status": "Int32",
        "Adaptation": "Int32",
    }


def test_flows_are_in_litres_per_minute_over_the_valves_range():
    nodes = by_name(estimator_variables(VALVE, RLS))
    assert nodes["PredictedFlow"].unit is Unit.LITRE_PER_MINUTE
    assert nodes["PredictedFlow"].range == (0.0, 200.0)
    assert nodes["Residual"].range == (-200.0, 200.0)
    assert nodes["ResidualRmse"].range == (0.0, 200.0)


def test_enumerations_name_every_value():
    status = by_name(estimator_variables(VALVE, RLS))["Status"]
    assert status.enum_strings == tuple(member.name for member in Status)
    assert all(member.sentence in status.description for member in Status)
    adaptation = by_name(estimator_variables(VALVE, RLS))["Adaptation"]
    assert adaptation.enum_strings == tuple(member.name for member in Adaptation)
    assert all(member.sentence in adaptation.description for member in Adaptation)
    required = by_name(inverse_variables(VALVE))["RequiredUStatus"]
    assert required.enum_strings == tuple(member.name for member in InverseStatus)
    written = by_name(inverse_variables(VALVE))["FeedForwardStatus"]
    assert written.enum_strings == tuple(member.name for member in FeedForwardStatus)
    assert all(member.sentence in written.description for member in FeedForwardStatus)


def test_only_the_demand_is_writable():
    nodes = by_name((*inverse_variables(VALVE), *estimator_variables(VALVE, RLS)))
    writable = {name for name, node in nodes.items() if node.writable}
    assert writable == {"FlowDemand", "PressureDrop"}
    assert nodes["FlowDemand"].range == (0.0, 200.0)
    assert nodes["PressureDrop"].range == (0.0, 150.0)
    assert nodes["PressureDrop"].unit is Unit.BAR
    assert nodes["RequiredU"].unit is Unit.PERCENT


def test_every_node_says_what_it_is():
    nodes = (*estimator_variables(VALVE, RLS), *inverse_variables(VALVE), map_variable(VALVE))
    assert all(node.description.strip() for node in nodes)


def test_the_map_has_a_row_per_flow_and_a_column_per_pressure_drop():
    assert map_variable(VALVE).dimensions == (3, 2)
    assert map_variable(VALVE).id == "Valvistor.Inverse.Map"


def test_an_axis_tells_its_unit_range_and_steps():
    bars = axis("Pressure drop", Unit.BAR, (50.0, 100.0))
    assert bars.AxisSteps == [50.0, 100.0]
    assert (bars.EURange.Low, bars.EURange.High) == (50.0, 100.0)
    assert bars.EngineeringUnits.UnitId == 4342098
    assert bars.AxisScaleType == ua.AxisScaleEnumeration.Linear


def test_counters_become_nodes_in_camel_case_with_a_meaning():
    node = counter_variable("V1", "clock_steps")
    assert node.id == "V1.Diagnostics.ClockSteps"
    assert node.kind == ua.VariantType.UInt64
    assert "Jumps of the source's clock" in node.description
    assert "Something new" in counter_variable("V1", "something_new").description


@pytest.mark.parametrize(
    ("valves", "words"),
    [
        ([ValveDescription("V.1", (RLS,))], "valve 'V.1'"),
        ([ValveDescription("", (RLS,))], "valve ''"),
        ([ValveDescription("V1", ()), ValveDescription("V1", ())], "valve 'V1': the name is taken"),
        ([ValveDescription("Identification", ())], "the name is taken"),
        (
            [
                ValveDescription(
                    "V1", (EstimatorDescription("Inverse", "", (), has_forgetting_factor=False),)
                )
            ],
            "valve V1: estimator 'Inverse'",
        ),
        ([ValveDescription("V1", (RLS, RLS))], "estimator 'RLS': the name is taken"),
    ],
)
def test_names_that_would_break_an_id_or_a_path_are_refused(valves, words):
    with pytest.raises(ConfigurationError) as error:
        check_names(valves)
    assert words in str(error.value)


def test_good_names_pass():
    check_names([VALVE, ValveDescription("V-2_b", (RLS,))])
    assert np.isfinite(VALVE.map_Q).all()
