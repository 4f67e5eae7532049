from pathlib import Path

import pytest
from pydantic import ValidationError

from valvemap_rig.circuit import Circuit
from valvemap_rig.oil import Oil
from valvemap_rig.parameters import data_sheet
from valvemap_rig.valvistor import Valvistor

PAGE = Path(__file__).parents[2] / "docs" / "rig.md"


@pytest.mark.parametrize("model", [Valvistor, Oil, Circuit])
def test_every_parameter_has_unit_default_meaning_and_source(model):
    rows = data_sheet(model)
    assert [name for name, *_ in rows] == list(model.model_fields)
    for _, default, unit, description, source in rows:
        assert isinstance(default, float)
        assert unit
        assert description
        assert source


@pytest.mark.parametrize("model", [Valvistor, Oil, Circuit])
def test_the_page_shows_every_parameter_as_it_is(model):
    page = PAGE.read_text(encoding="utf-8")
    for name, default, unit, description, source in data_sheet(model):
        assert f"| `{name}` | {default:g} | {unit} | {description} | {source} |" in page


def test_an_unknown_parameter_is_refused_with_those_that_are_known():
    with pytest.raises(ValidationError, match=r"unknown field 'K_mp'; allowed are phi, K_MP"):
        Valvistor(K_mp=1.0)
