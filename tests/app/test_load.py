"""Short forms of the long rows of `docs/reliability.md`: a slow disk, load, half a processor."""

import pytest

from benchmarks.reliability_load import slow_disk, soak

pytestmark = pytest.mark.waits

VALVES, HZ, SECONDS = 10, 20.0, 10.0
HELD_S, END_S, AGE_S = 0.3, 5.0, 1.0  # the bars of the long rows
ROOM = 2.0  # other tests run beside these


async def test_a_disk_that_takes_two_seconds_to_sync_holds_neither_loop_nor_end():
    seen = await slow_disk(VALVES, HZ, SECONDS)
    assert seen.held_s <= HELD_S, seen
    assert seen.end_s <= ROOM * END_S, seen


# Beside other tests, half a processor is a quarter.
@pytest.mark.parametrize("half", [False, pytest.param(True, marks=pytest.mark.alone)])
async def test_under_load_nothing_is_lost_or_old_and_good_also_with_half_a_processor(half):
    run = await soak(VALVES, HZ, SECONDS, half=half)
    assert (run.lost, run.wrong, run.old_and_good) == (0, 0, 0), run
    assert run.learnt > 0.8 * VALVES * HZ * SECONDS, run
    assert run.age_p99_s <= ROOM * AGE_S, run
