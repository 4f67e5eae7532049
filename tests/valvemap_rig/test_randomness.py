import numpy as np
import pytest

from valvemap_rig.randomness import normal, uniform


@pytest.mark.parametrize("draw", [normal, uniform])
@pytest.mark.parametrize(("start", "n"), [(0, 0), (0, 1), (1023, 2), (1024, 1024), (500, 3000)])
def test_a_number_is_the_same_in_whatever_block_it_is_drawn(draw, start, n):
    whole = draw(5, "stream", 0, 5000)
    assert draw(5, "stream", start, n).tobytes() == whole[start : start + n].tobytes()


def test_streams_and_seeds_are_independent():
    a, b, c = normal(1, "a", 0, 20_000), normal(1, "b", 0, 20_000), normal(2, "a", 0, 20_000)
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.03
    assert abs(np.corrcoef(a, c)[0, 1]) < 0.03


def test_numbers_far_out_can_be_had_at_once():
    assert normal(1, "a", 10**12, 3).shape == (3,)


def test_the_numbers_are_those_of_the_reference():
    # Should a new numpy draw otherwise, recordings made with a seed can no longer be repeated.
    reference = [-1.0185906219639826, -0.28636908843434083]
    assert normal(1, "Valvistor.Q noise", 0, 2).tolist() == pytest.approx(reference, rel=1e-12)
