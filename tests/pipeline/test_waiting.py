"""Why no sample is made: the signal, the reason and the setting are named."""

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.pipeline.alignment import AlignmentSettings
from valvemap.pipeline.kernels.waiting import NEVER
from valvemap.pipeline.waiting import waited_for
from valvemap.vocabulary.signals import Signal

T = 1_800_000_000_000_000_000
MS = 1_000_000
SELDOM = (
    "p2 sent its last value 4.0 s before the others: if it comes on change, "
    "alignment.hold_s = { p2 = 20 }"
)


@pytest.mark.parametrize(
    ("newest", "said"),
    [
        ([T, T, T, T, T], ()),
        ([NEVER] * 5, ("no signal has sent a value: does the source publish?",)),
        ([T, T, NEVER, T, T], ("p2 has sent no value: is nodes.p2 the right node?",)),
        (
            [T, T, T, T - 3 * MS, T],
            ("Q is stamped 3 ms before the others: alignment.tolerance_ms = 6",),
        ),
        ([T, T, T - 4000 * MS, T, T], (SELDOM,)),
    ],
)
def test_the_signal_that_is_waited_for_is_named_with_what_helps(newest, said):
    assert waited_for(np.array(newest), AlignmentSettings(), optional=("T",)) == said


def test_a_setting_that_is_there_is_asked_for_no_more():
    newest = np.array([T, T - 3 * MS, T - 4000 * MS, T, NEVER])
    settings = AlignmentSettings(tolerance_ns=5 * MS, hold_ns={Signal.P2: 10_000 * MS})
    assert waited_for(newest, settings, optional=()) == ()


def test_a_valve_without_its_flow_says_so_while_it_is_lost(identification):
    changes = as_changes(plant(20))
    identification.take(changes[changes.item != Signal.Q])
    (results,) = identification.results.of([0], lost=np.array([True]))
    assert results.waiting == [("Q has sent no value: is nodes.Q the right node?",)]
    (results,) = identification.results.of([0])
    assert results.waiting == [()]
