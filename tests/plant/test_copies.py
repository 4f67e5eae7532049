"""A copy of a signal, equal or rounded, is left out instead of asked."""

import numpy as np

from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import group
from valvemap.plant.reading import Record
from valvemap.plant.roles import Role
from valvemap.plant.verdict import judge

T = np.arange(0.0, 20.0, 0.05)


def judged(**more):
    rng = np.random.default_rng(5)
    U = 50 + 40 * np.sin(1.3 * T)
    p2 = 60 + 30 * np.sin(0.7 * T)
    Q = np.round(0.06 * U * np.sqrt(180 - p2) + rng.normal(0.0, 0.1, len(T)), 2)
    rows = {
        "Command": (U, "%"),
        "Inlet pressure": (180.0 + rng.normal(0.0, 0.1, len(T)), "bar"),
        "Outlet pressure": (p2, "bar"),
        "Flow": (Q, "l/min"),
        **{name.replace("_", " "): (make(Q), "l/min") for name, make in more.items()},
    }
    found = [Candidate(n, ("Bench", n), unit_of(unit)) for n, (_, unit) in rows.items()]
    (one,) = group(found)
    return judge(one, Record({n: values for n, (values, _) in rows.items()}, 0.05))


def test_a_rounded_copy_is_left_out_and_named():
    verdict = judged(Flow_HMI=np.round)
    assert verdict.question is None
    assert verdict.reading.nodes[Role.Q].node == "Flow"
    assert verdict.others["Flow HMI"] is Role.Q


def test_the_rounded_one_is_the_copy_whatever_its_name():
    verdict = judged(Flow_exact=lambda Q: Q + 0.003 * np.sin(T))
    assert verdict.reading.nodes[Role.Q].node == "Flow exact"


def test_a_second_meter_that_is_rounded_and_off_is_no_copy():
    for step in (1.0, 5.0):
        verdict = judged(Flow_2=lambda Q, step=step: step * np.round(1.04 * Q / step))
        assert verdict.others.get("Flow 2") is not Role.Q


def test_a_signal_at_rest_is_no_copy():
    verdict = judged(Flow_2=lambda Q: np.full(len(Q), 40.0))
    assert verdict.others.get("Flow") is not Role.Q
