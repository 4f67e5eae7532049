"""``valvemap serve`` killed at any time: what is on the disk is one life's, to the bit."""

import pytest

from benchmarks.reliability_lives import kills, reload

pytestmark = pytest.mark.waits

SOAK = [pytest.mark.soak, pytest.mark.timeout(3600)]


@pytest.mark.parametrize("count", [2, pytest.param(60, marks=SOAK)])
async def test_killed_and_started_from_the_history_it_has_lost_nothing(count):
    account, unreadable = await kills(count, seed=count, warm_start_s=10.0)
    assert (account.lost, account.twice, account.different, unreadable) == (0, 0, (), 0)
    assert account.learnt > 1000


@pytest.mark.soak
async def test_a_valve_left_alone_by_a_hang_up_has_the_bits_of_one_life():
    account = await reload()
    assert (account.lost, account.twice, account.different) == (0, 0, ())
