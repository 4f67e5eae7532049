"""Every misprint fails where the right form holds; and the figures decide, not the text."""

from dataclasses import replace

import numpy as np
import pytest

from paper import errata_least_squares
from paper.errata import show
from paper.errata_least_squares import of_least_squares
from paper.errata_valve import of_the_valve
from paper.erratum import Erratum
from valvemap.model.rbf_network import RbfNetwork


@pytest.fixture(scope="module")
def errata(paper_data):
    return show(paper_data, RbfNetwork())


def test_every_misprint_is_shown_failing_beside_the_right_form(errata):
    assert [erratum.equation for erratum in errata if not erratum.shown] == []


@pytest.mark.parametrize(
    "equation",
    [
        "(3)", "(5)", "pilot stage", "(7), inverted", "before (13), (22)", "(15)", "(18)",
        "before (26)", "(26)", "(27)", "(28)", "nomenclature, P", "nomenclature, a_i and U",
        "section 4, text", "(29)", "(30)", "(31)", "(32)", "(33)–(36)", "(37)",
    ],
)  # fmt: skip
def test_no_misprint_is_left_out(errata, equation):
    assert equation in [erratum.equation for erratum in errata]


def test_of_a_valve_that_obeys_the_printed_equation_3_the_misprint_is_not_shown(paper_data):
    ideal = paper_data.ideal
    obeying = ideal.Q_PV / ideal.K_c * np.sqrt((ideal.phi - 1) / (ideal.phi * ideal.dp)) - ideal.x_0
    doctored = replace(paper_data, ideal=replace(ideal, x_MP=np.maximum(obeying, 0.0)))
    stroke = next(iter(of_the_valve(doctored)))
    assert stroke.equation == "(3)"
    assert not stroke.printed_fails
    assert not stroke.right_holds


def test_without_forgetting_the_misprints_about_it_do_no_harm(paper_data, monkeypatch):
    monkeypatch.setattr(errata_least_squares, "LAM", 1.0)
    shown = {e.equation: e for e in of_least_squares(paper_data)}
    for equation in ("before (26)", "(26)"):
        assert shown[equation].right_holds
        assert not shown[equation].printed_fails


@pytest.mark.parametrize(
    ("printed", "right", "shown"),
    [
        (2.0, 0.5, True),
        (0.5, 0.5, False),
        (2.0, 2.0, False),
        (np.inf, 1.0, True),
        (np.nan, 0, True),
    ],
)
def test_a_misprint_is_shown_if_one_form_fails_and_the_other_holds(printed, right, shown):
    erratum = Erratum("(0)", "printed", "right", "error", printed, right, 1.0, "because")
    assert erratum.shown is shown
