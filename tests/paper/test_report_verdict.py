"""How a verdict follows from figures, and figures from several sets of recordings."""

import math

import pytest

from paper.verdict import Claim, Part, Verdict


def part(value, printed=None, must="at most", limit=1.0):
    as_printed = () if printed is None else (printed,)
    return Part("it is small", "", must, limit, "because", (value,), as_printed, "(0)")


@pytest.mark.parametrize(
    ("parts", "verdict"),
    [
        ([part(0.5), part(1.0)], Verdict.REPRODUCED),
        ([part(0.5), part(2.0)], Verdict.NOT_REPRODUCED),
        ([part(0.5), part(2.0, printed=0.5)], Verdict.EXPLAINED),
        ([part(2.0), part(2.0, printed=0.5)], Verdict.NOT_REPRODUCED),
        ([part(2.0, printed=3.0)], Verdict.NOT_REPRODUCED),
        ([part(0.5, printed=2.0)], Verdict.REPRODUCED),
        ([part(1.0, must="more than")], Verdict.NOT_REPRODUCED),
        ([part(math.inf, must="more than")], Verdict.REPRODUCED),
    ],
)
def test_a_claim_stands_with_all_its_parts_or_with_the_misprints(parts, verdict):
    assert Claim(1, "all is well", tuple(parts)).verdict is verdict


@pytest.mark.parametrize("must", ["at most", "more than"])
def test_what_is_not_a_number_never_holds(must):
    assert not part(math.nan, must=must).holds


def test_the_median_of_the_sets_decides_and_those_that_agree_are_counted():
    sets = [Claim(1, "all is well", (part(value),)) for value in (0.5, 9.0, 0.7, 0.8, 9.0)]
    merged = Claim.merged(sets)
    assert merged.parts[0].value == 0.8
    assert merged.verdict is Verdict.REPRODUCED
    assert merged.agreeing == 3


def test_the_printed_forms_have_a_median_of_their_own():
    sets = [Claim(1, "all is well", (part(2.0, printed),)) for printed in (0.5, math.inf, 0.6)]
    merged = Claim.merged(sets)
    assert merged.parts[0].value_as_printed == 0.6
    assert merged.verdict is Verdict.EXPLAINED
    assert merged.agreeing == 2
