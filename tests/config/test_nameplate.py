"""What a configuration says of a valve itself."""

import pytest

from valvemap.app.build import build_identification
from valvemap.app.warm_up import _one_of_each_kind
from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError

VALVE = """
[[valves]]
name = "{name}"
[valves.identification]
{said}
"""


def loaded(tmp_path, *valves):
    file = tmp_path / "service.toml"
    text = "".join(VALVE.format(name=name, said=said) for name, said in valves)
    file.write_text(text, encoding="utf-8")
    return load_config(file)


def test_what_is_said_of_a_valve_is_described(tmp_path):
    said = """manufacturer = "Muster AG"
    serial_number = "4711"
    product_instance_uri = "https://muster.example/V-100/4711"
    asset_id = "P-12"
    location = "Halle 3"
    """
    (valve,) = build_identification(loaded(tmp_path, ("V1", said))).descriptions()
    plate = valve.nameplate
    assert (plate.manufacturer, plate.serial_number) == ("Muster AG", "4711")
    assert plate.product_instance_uri == "https://muster.example/V-100/4711"
    assert (plate.asset_id, plate.location) == ("P-12", "Halle 3")
    assert (plate.model, plate.component_name) == ("", "V1")


def test_the_plants_own_name_goes_before_the_valves(tmp_path):
    config = loaded(tmp_path, ("V1", 'component_name = "Boom"'))
    (valve,) = build_identification(config).descriptions()
    assert valve.nameplate.component_name == "Boom"


@pytest.mark.parametrize(
    ("said", "field"),
    [
        ('product_instance_uri = "4711"', "product_instance_uri"),
        ('manufacturer = ""', "manufacturer"),
        ('colour = "red"', "colour"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, said, field):
    with pytest.raises(ConfigurationError) as caught:
        loaded(tmp_path, ("V1", said))
    assert field in str(caught.value)


def test_a_plate_compiles_nothing_anew_and_splits_no_fleet(tmp_path):
    config = loaded(tmp_path, ("V1", 'serial_number = "1"'), ("V2", 'serial_number = "2"'))
    assert len(_one_of_each_kind(config).valves) == 1
    assert len(build_identification(config).valves.one_of_each_kind()) == 1
