"""The paper's Figure 1 is judged by maps from nine kinds of recordings."""

import numpy as np
import pytest

from paper.claims_data import claim_15
from paper.source_types import FORMS, LEVELS, RATES_HZ, TIMES, SourceTypes, recording
from paper.verdict import Verdict


def types(quasi_static=0.6, quick=20.0, with_spool=0.4, structured=0.2):
    at_rest = {"structured": structured, "scattered": 0.06, "operating points": 3.0}
    static = {
        "static": at_rest,
        "quasi-static": dict.fromkeys(FORMS, quasi_static),
        "dynamic": dict.fromkeys(FORMS, quick),
    }
    return SourceTypes(static, dict.fromkeys(FORMS, with_spool))


@pytest.mark.parametrize(
    ("given", "verdict"),
    [
        ({}, Verdict.REPRODUCED),
        ({"quasi_static": 1.2}, Verdict.NOT_REPRODUCED),
        ({"quick": 0.7}, Verdict.NOT_REPRODUCED),
        ({"with_spool": np.inf}, Verdict.NOT_REPRODUCED),
        ({"structured": 0.06}, Verdict.NOT_REPRODUCED),
    ],
)
def test_each_part_decides(given, verdict):
    assert claim_15(types(**given)).verdict is verdict


def test_recordings_are_what_their_names_say():
    kinds = {(time, form): recording(3, time, form) for time in TIMES for form in FORMS}
    for (time, form), samples in kinds.items():
        per_s = float(np.abs(np.diff(samples.U)).mean()) * RATES_HZ[time]
        assert (form == "structured") == bool(np.isin(samples.U, LEVELS).all()), (time, form)
        if (time, form) == ("quasi-static", "scattered"):
            assert per_s < 5.0  # %/s
        if form == "scattered":
            assert np.ptp(samples.U) > 95.0
        if time == "dynamic":
            assert per_s > 15.0


@pytest.mark.soak
def test_on_a_simulated_valve_the_paper_is_right():
    assert claim_15(SourceTypes.measured(1)).verdict is Verdict.REPRODUCED
