"""What fits beside the service may take: processor time, not time of a busy machine's clock."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from valvemap.clock import ManualClock
from valvemap.model.dynamics import NotFitted
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.by_valve import ByValve
from valvemap.runtime.dynamics import LiveDynamics
from valvemap.vocabulary.dynamics import DynamicsStatus

WINDOW_S = 10.0


def a_second(k):
    t = (k * 100 + np.arange(100)) * 10**7
    flat = np.zeros(100)
    segments = Segments(np.zeros(1, np.int64), np.zeros(1, np.int64), np.full(1, 100))
    return ByValve(Samples.of(t, flat, flat + 100.0, flat, flat), segments)


async def seconds_until_the_second_fit(fit, share, monkeypatch):
    """Return for how long the clock runs from the end of the first fit to the second one."""
    monkeypatch.setattr("valvemap.pipeline.valve_dynamics.fit_dynamics", lambda _: fit())
    identification = SimpleNamespace(
        plans=[SimpleNamespace(name="V")],
        journal=None,
        note_dynamics=lambda *_: None,
        judge_dynamics=lambda *_: None,
    )
    clock, fits = ManualClock(), []
    live = LiveDynamics(identification, clock, share, WINDOW_S)
    for k in range(1_000):
        live.take(a_second(k))
        clock.advance(1.0)
        before = live._fit
        live.tick()
        if live._fit is not before:
            await live._fit
            fits.append(k)
        if len(fits) == 2:
            break
    return fits[1] - fits[0]


def nothing():
    return NotFitted(DynamicsStatus.UNEXCITED, "")


def sleep():
    time.sleep(0.3)
    return nothing()


def compute():
    end = time.thread_time() + 0.3
    while time.thread_time() < end:
        pass
    return nothing()


def fail():
    compute()
    raise ValueError


@pytest.mark.parametrize(
    ("fit", "least", "most"), [(sleep, 0, 5), (compute, 25, 60), (fail, 25, 60)]
)
async def test_a_fit_rests_for_its_processor_time_however_it_ends(fit, least, most, monkeypatch):
    # .3 s at a share of .01: 30 s of rest; a fit that waited for the processor has used none of it
    assert least <= await seconds_until_the_second_fit(fit, 0.01, monkeypatch) <= most
