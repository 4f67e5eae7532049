"""A small fleet: groups, blocks of their samples, and an engine that is a dictionary."""

import numpy as np

from support.plant import plant
from valvemap.config.estimators import RbfConfig, RlsConfig, RmlConfig
from valvemap.config.models import Config
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.kafka.blocks import SamplesBlock, write_samples
from valvemap.kafka.catalogue import catalogue_of
from valvemap.kafka.commands import Command, Reply, write_message
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.result_blocks import write_results
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.by_valve import ByValve

ESTIMATORS = (RlsConfig(), RmlConfig(), RbfConfig())
RHYTHM = Rhythm(results_ns=200_000_000, maps_ns=1_000_000_000)


def site(valves, estimators=ESTIMATORS):
    """A site of some valves, by name."""
    return Config(
        valves=tuple(
            ValveConfig(name=name, nodes=NodesConfig.of_rig(name), estimators=estimators)
            for name in valves
        )
    )


def catalogue(valves=5, version=1, estimators=ESTIMATORS, per_group=3):
    names = [f"V{k}" for k in range(valves)]
    return catalogue_of({"north": site(names, estimators)}, version, per_group)


def block(plan, number, lengths, seed=0, first=0):
    """A block of scattered samples of a group's valves, the n-th since ``first``."""
    parts = [plant(n, seed=1000 * seed + k, first=first) for k, n in enumerate(lengths)]
    edges = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    members = np.flatnonzero(np.diff(edges))
    samples = ByValve(
        Samples.concatenate(parts), Segments(members, edges[members], edges[members + 1])
    )
    return SamplesBlock(plan.name, number, tuple(one.name for one in plan.plans), samples)


def day(plan, blocks=12, seed=0):
    """Blocks of uneven lengths, and commands between them."""
    rng = np.random.default_rng(seed)
    found, first = [], 0
    for number in range(1, blocks + 1):
        lengths = rng.integers(0, 25, len(plan.plans))
        found.append(block(plan, number, lengths, seed=number + 100 * seed, first=first))
        first += 25
        if number == blocks // 3:
            name = plan.plans[0].name
            found.append(Command("1", plan.name, name, "demand", "", (60.0, 100.0)))
            found.append(Command("2", plan.name, name, "freeze", "RML"))
            name = plan.plans[-1].name
            found.append(Command("3", plan.name, name, "set_forgetting_factor", "RML", (0.99,)))
            found.append(Command("4", plan.name, name, "approve"))
    return found


def group(plan, version=1):
    return Group(plan, version, RHYTHM)


def feed(one, messages):
    """What comes out, as bytes."""
    out = []
    for message in messages:
        steps = one.do(message) if isinstance(message, Command) else one.take(message)
        out += [
            write_message(step) if isinstance(step, Reply) else write_results(step)
            for step in steps
        ]
    return out


class Dictionary:
    """A store that an engine rolls back: what is not committed is as if it had not been."""

    def __init__(self):
        self.kept, self._new = {}, {}

    def get_bytes(self, key):
        return self._new.get(key, self.kept.get(key))

    def set_bytes(self, key, value):
        self._new[key] = value

    def commit(self):
        self.kept.update(self._new)
        self._new = {}

    def abort(self):
        self._new = {}


def as_messages(items):
    """Blocks and commands as they travel: kind, key, bytes."""
    for one in items:
        if isinstance(one, Command):
            yield "commands", one.group.encode(), write_message(one)
        else:
            yield "samples", one.group.encode(), write_samples(one)
