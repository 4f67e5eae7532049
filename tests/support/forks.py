"""Pipeline and storage in processes that are forked and killed, hundreds of times."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from support.plant import lively
from valvemap.app.build import build_identification
from valvemap.config.loading import load_config
from valvemap.config.samples import GateConfig
from valvemap.config.valves import ValveConfig
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.provenance import ALARMS
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage.checkpoints import LOG, CheckpointFile
from valvemap.vocabulary.signals import PER_VALVE

GATE = {"U": {"max_rate_per_s": 400.0}, "T": {"frozen_s": 1e6}, "Q": {"spike": 60.0}}
AT_ONCE = 5  # samples in a batch, and …
SAVED_AFTER = 3  # … batches between two saves
MOST_STEPS = 3 * (SAVED_AFTER + 1)  # of a life: batches and saves, after which it is killed …
LONGEST_STEP_S = 0.02  # … amid the next
PLACE = "Source", "Position"
STEP_NS, START = 10_000_000, 1_800_000_000_000_000_000


def fresh():
    """All estimators of the default, gates on."""
    valve = ValveConfig(name="V1", gate=GateConfig.model_validate(GATE))
    return build_identification(load_config().model_copy(update={"valves": (valve,)}))


def sent(first, n):
    """Samples of a source that has each for ever."""
    k = range(first, first + n)
    return DataChanges(
        item=np.tile(np.arange(PER_VALVE, dtype=np.int32), n),
        value=np.array([[*lively(one, 0), one] for one in k]).ravel(),
        status=np.zeros(PER_VALVE * n, np.uint32),
        source_time=np.repeat(START + np.arange(first, first + n) * STEP_NS, PER_VALVE),
    )


def life(identification, file, stop=None, step=lambda: None):
    """Go on where the last life's states are, until killed, or until a sample is reached."""
    with CheckpointFile(file) as store:
        kept = store.load()
        assert store.set_aside is None
        assert not set(store.damaged) - {LOG}, store.damaged
        place = next((c for c in kept if (c.valve, c.estimator) == PLACE), None)
        at = 0 if place is None else place.t
        _, refused = identification.restore([c for c in kept if c is not place])
        assert not refused, refused
        while stop is None or at < stop:
            for _ in range(SAVED_AFTER):
                step()
                n = AT_ONCE if stop is None else min(AT_ONCE, stop - at)
                if n:
                    identification.take(sent(at, n))
                at += n
            now = Checkpoint(*PLACE, "", at, b"", lam=None, frozen=False)
            step()
            store.save([*identification.states.kept(), now])
    return at


def killed(kills, seed, file):
    """Kill so many lives at random moments; return what they come to against one life."""
    file, rng, unreadable = Path(file), np.random.default_rng(seed), 0
    waiting = fresh()  # what is made, compiled and imported is every child's
    waiting.take(sent(0, 50))
    waiting = fresh()
    for _ in range(kills):
        steps, makes_steps = os.pipe()
        child = os.fork()
        if not child:
            os._exit(_in_child(waiting, file, makes_steps))
        os.close(makes_steps)
        for _ in range(int(rng.integers(MOST_STEPS))):
            os.read(steps, 1)
        os.close(steps)
        time.sleep(float(rng.uniform(0.0, LONGEST_STEP_S)))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        unreadable += not os.WIFSIGNALED(status)  # it has ended by itself: its state was refused
    last = waiting
    with CheckpointFile(file) as store:
        reached = max((c.t for c in store.load() if (c.valve, c.estimator) == PLACE), default=0)
    stop = life(last, file, reached + 100)
    once = fresh()
    for first in range(0, stop, 1000):
        once.take(sent(first, min(1000, stop - first)))
    counters, right = last.results.counters(0), once.results.counters(0)
    ours, theirs = (
        {(c.valve, c.estimator): c.state for c in one.states.kept() if c.estimator != ALARMS}
        for one in (last, once)
    )
    return {
        "samples": stop,
        "lost": stop - counters["aligned"],
        "twice": counters["duplicates"] + counters["late"],
        "different": sum(ours[name] != theirs[name] for name in theirs) + (counters != right),
        "unreadable": unreadable,
    }


def _in_child(identification, file, makes_steps):
    try:
        life(identification, file, step=lambda: os.write(makes_steps, b"1"))
    except BaseException as error:  # noqa: BLE001 - the parent sees that it ended
        sys.stderr.write(f"{error!r}\n")
    return 1


if __name__ == "__main__":
    kills, seed, file = sys.argv[1:]
    print(json.dumps(killed(int(kills), int(seed), file)))  # noqa: T201
