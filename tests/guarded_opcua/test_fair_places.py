"""Places are dealt out fairly among addresses, however often one asks."""

from hypothesis import given, seed
from hypothesis import strategies as st

from guarded_opcua import ManualClock
from guarded_opcua.admission import Admission

MOST, OF_ADDRESS = 6, 4


class Places:
    """An admission of (host, number); those in ``staying`` do not give way."""

    def __init__(self, per_second=1_000):
        self.clock, self.gone, self.staying = ManualClock(), [], set()
        self.admission = Admission(
            self.clock,
            MOST,
            OF_ADDRESS,
            per_second,
            lambda holder: holder[1],
            lambda newcomer: self.staying,
            self.gone.append,
        )

    def fill(self, host, numbers):
        return [self.admission.admit((host, number), host) for number in numbers]


@seed(1)
@given(st.lists(st.tuples(st.integers(1, 9), st.booleans()), max_size=60))
def test_no_bound_is_ever_passed_and_who_stays_is_never_ended(asked):
    places = Places()
    for number, (host, stays) in enumerate(asked):
        holder = (f"10.0.0.{host}", number)
        if places.admission.admit(holder, holder[0]) and stays:
            places.staying.add(holder)
        held = list(places.admission)
        assert len(held) <= MOST
        assert all(places.admission.held_at(host) <= OF_ADDRESS for host, _ in held)
        assert not places.staying & set(places.gone)


def test_a_newcomer_takes_the_place_of_the_address_that_holds_most():
    places = Places()
    places.fill("10.0.0.1", range(4))
    places.fill("10.0.0.2", range(2))
    assert places.fill("10.0.0.3", [9]) == [True]
    assert places.gone == [("10.0.0.1", 0)]


def test_an_address_that_holds_its_share_makes_room_for_itself_alone():
    places = Places()
    places.fill("10.0.0.2", [0])
    assert places.fill("10.0.0.1", range(1, 8)) == 7 * [True]
    assert places.gone == [("10.0.0.1", number) for number in (1, 2, 3)]


def test_where_all_stay_a_newcomer_is_refused():
    places = Places()
    places.fill("10.0.0.1", range(4))
    places.fill("10.0.0.2", range(2))
    places.staying = set(places.admission)
    assert places.fill("10.0.0.3", [9]) == [False]
    assert places.admission.leave(("10.0.0.1", 2))
    assert places.fill("10.0.0.3", [9]) == [True]


def test_an_address_that_asks_too_often_waits_for_the_next_second_and_others_do_not():
    places = Places(per_second=2)
    assert places.fill("10.0.0.1", range(3)) == [True, True, False]
    assert places.fill("10.0.0.2", [0]) == [True]
    places.clock.advance(1.0)
    assert places.fill("10.0.0.1", [3]) == [True]


def test_an_ipv6_network_is_one_address():
    places = Places()
    for number in range(9):
        assert places.admission.admit((number, number), f"2001:db8::{number:x}")
    assert places.admission.held_at("2001:db8::abcd") == OF_ADDRESS
