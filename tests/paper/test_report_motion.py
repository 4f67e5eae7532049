"""The paper's open point is judged by the tracking errors of a cylinder."""

import pytest

from paper.claims_motion import claim_14
from paper.motion import Motion
from paper.verdict import Verdict

CASES = ("new", "supply -22 %", "two edges -30 %, 60 s later")


def motion(table, fixed, living):
    errors = {"PI alone": 25.0, "table": table, "fixed map": fixed, "living map": living}
    return Motion(dict.fromkeys(CASES, errors))


@pytest.mark.parametrize(
    ("errors", "verdict"),
    [
        ((4.0, 2.0, 1.0), Verdict.REPRODUCED),
        ((1.2, 2.0, 1.0), Verdict.NOT_REPRODUCED),
        ((4.0, 1.2, 1.0), Verdict.NOT_REPRODUCED),
    ],
)
def test_the_inverse_must_beat_the_table_and_the_living_map_the_fixed_one(errors, verdict):
    assert claim_14(motion(*errors)).verdict is verdict


@pytest.mark.soak
def test_on_the_rig_the_paper_is_right():
    claim = claim_14(Motion.measured(1))
    assert claim.verdict is Verdict.REPRODUCED
    assert claim.sets == 1
