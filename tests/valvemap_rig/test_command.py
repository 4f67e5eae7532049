from valvemap_rig.command import Command


def test_by_hand_a_command_holds_for_ever():
    assert Command().written(40.0).seen(1e6).in_force == 40.0


def test_nothing_commanded_is_the_rigs_own():
    assert Command().seen(0.0).in_force is None


def test_a_heartbeat_that_moves_keeps_the_command_in_force():
    command = Command().written(40.0)
    for n in range(1, 20):
        command = command.beaten(n, now=0.4 * n).seen(0.4 * n + 0.39)
        assert command.in_force == 40.0


def test_the_same_heartbeat_again_is_none():
    command = Command().written(40.0).beaten(7, now=0.0).beaten(7, now=0.4).seen(0.6)
    assert command.in_force is None


def test_from_a_standstill_only_a_new_command_under_a_new_heartbeat_leads_back():
    command = Command().written(40.0).beaten(7, now=0.0).seen(0.6)
    assert command.beaten(8, now=1.0).seen(1.1).in_force is None  # 40 % is dropped for good
    late = command.written(50.0)
    assert late.seen(0.7).in_force is None
    assert late.beaten(8, now=1.0).seen(1.1).in_force == 50.0


def test_a_standstill_between_two_looks_is_one():
    command = Command().written(40.0).beaten(7, now=0.0).beaten(8, now=0.6)
    assert command.seen(0.7).in_force is None


def test_zero_drops_the_command_at_once_and_gives_the_valve_to_the_hand():
    command = Command().written(40.0).beaten(7, now=0.0).beaten(0, now=0.1)
    assert command.in_force is None
    assert command.written(20.0).seen(9.0).in_force == 20.0


def test_the_load_falls_with_the_heartbeat_as_the_signal_does():
    command = Command().written(40.0).loaded(120.0).beaten(7, now=0.0)
    assert command.seen(0.44).load_in_force == 120.0
    assert command.seen(0.46).load_in_force is None
    assert command.beaten(0, now=0.1).load_in_force is None
