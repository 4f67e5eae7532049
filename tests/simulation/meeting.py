"""Valves whose samples need those of others: edges of a line, and valves behind one meter."""

import numpy as np

from simulation.ports import LINE
from valvemap.pipeline.edges import gathered
from valvemap.vocabulary.signals import Signal

METER = "Q"


def give_one_flow(server):
    """Give all valves of a server the flow of one meter, the sum of theirs."""
    rows = [server.values[valve] for valve in server.case.valves]
    flow = np.sum([values[:, Signal.Q] for values in rows], axis=0)
    for values in rows:
        values[:, Signal.Q] = flow


def rows_behind(world, valve):
    """The rows that a sample of a valve needs."""
    if world.case.meter:
        return set(range(world.case.valves))
    return {LINE, valve} if world.case.ports else {valve}


def learnt_samples(identification, valve):
    """The number of samples that a valve has learnt from, or passed: those that met others."""
    aligned = identification.results.counters(valve)["aligned"]
    intake = identification._parts.intake
    dropped = intake.splitter.dropped[valve] + intake.meters.dropped[valve]
    return aligned - int(dropped) - len(times_unmet(identification, valve))


def times_unmet(identification, valve):
    """The times of a valve's samples that wait for those of others."""
    intake = identification._parts.intake
    if valve in intake.splitter._edges:
        return intake.splitter._edges[valve][1].own.t.tolist()
    if valve in intake.meters._of:
        meter, place = intake.meters._of[valve]
        return meter.waiting[place].t.tolist()
    return []


def relive_together(world, identification):
    """Learn the samples of valves behind one meter without a disturbance, as they met."""
    rows = world.learnt[0]
    t = world.servers[0].t[rows]
    for part in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(t) <= 0) + 1):
        if not len(part):  # nothing was learnt
            continue
        batches = [
            world.server_of[valve].as_samples(valve, [rows[k] for k in part], one.gains)
            for valve, one in enumerate(world.plant)
        ]
        parts = {valve: samples for one in batches for valve, samples in one.items()}
        identification.learn(gathered(parts))
