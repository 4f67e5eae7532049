"""A worker and a results server survive any message, and learn the honest ones as if alone."""

import resource
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from support import hostile_messages as hostile
from support.fleet import RHYTHM, Dictionary, as_messages, block, catalogue, day, feed, group
from valvemap.errors import BlockError
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.commands import Command, Reply, write_message
from valvemap.kafka.decoding import Decoder, Rejected
from valvemap.kafka.memory import read_memory, write_memory
from valvemap.kafka.result_blocks import write_results
from valvemap.kafka.worker import MEMORY, Worker

# Of sums over flows of 1e308 l/min: outside of tests a warning, no exception.
pytestmark = pytest.mark.filterwarnings("ignore:(overflow|invalid value|divide by zero)")

NAME = "north.0"
KEY = NAME.encode()
MUTANTS = 600
LIKELY_BAD = 0.5  # of the mutants: the others are honest by chance, and are learnt


@pytest.fixture(scope="module")
def known():
    return catalogue()


@pytest.fixture(scope="module")
def honest(known):
    return list(as_messages(day(known.groups[NAME])))


@pytest.fixture(scope="module")
def alone(known):
    one = group(known.groups[NAME])
    return feed(one, day(known.groups[NAME])), one.to_bytes()


def learnt(packed):
    """A memory but for what it counts."""
    return write_memory(replace(read_memory(packed), counts={}))


def run(worker, store, message):
    kind, key, packed = message
    return (worker.samples if kind == "samples" else worker.command)(key, packed, store)


def rows(plan):
    sent = write_samples(block(plan, 7, (20, 20, 20)))
    yield from (("commands", name, one) for name, one in hostile.commands())
    yield from (("samples", name, one) for name, one in hostile.blocks(sent))


def test_the_rows_are_rejected_quickly_and_what_is_around_them_is_learnt_bit_for_bit(
    known, honest, alone
):
    worker, store, out = Worker(known, RHYTHM), Dictionary(), []
    bad = list(rows(known.groups[NAME]))
    share = -(-len(bad) // len(honest))
    for k, message in enumerate(honest):
        out += run(worker, store, message)
        for kind, name, packed in bad[k * share : (k + 1) * share]:
            began, kB = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            assert run(worker, store, (kind, KEY, packed)) == [], name
            assert time.process_time() - began < 1.0, name
            assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - kB < 64_000, name
            (letter,) = worker.rejected()
            assert letter.reason, name
            assert len(letter.payload) <= 65_536
            assert letter.size == len(packed)
        worker.keep()
        store.commit()
    assert out == alone[0]
    assert learnt(store.kept[MEMORY]) == learnt(alone[1])
    assert read_memory(store.kept[MEMORY]).counts["refused"] == len(bad)


def expected(decoder, one, message):
    """The output of a group alone, if the message is valid."""
    kind, key, packed = message
    found = (decoder.samples if kind == "samples" else decoder.command)(key, packed)
    if isinstance(found, Rejected):
        one.refuse()
        return []
    steps = one.do(found) if isinstance(found, Command) else one.take(found)
    try:
        return [
            write_message(step) if isinstance(step, Reply) else write_results(step)
            for step in steps
        ]
    except BlockError:
        one.refuse()
        return []


def survive(known, honest, mutants, seed):
    """Mutants between honest messages: what is learnt is what a group alone learns of all."""
    dice = np.random.default_rng(seed)
    worker, store, one = Worker(known, RHYTHM), Dictionary(), group(known.groups[NAME])
    decoder, rejected = Decoder(known), 0
    for _ in range(mutants):
        kind, key, packed = honest[dice.integers(len(honest))]
        message = kind, key, hostile.mutant(packed, dice)
        began = time.process_time()
        out = run(worker, store, message)
        assert time.process_time() - began < 1.0
        rejected += len(worker.rejected())
        assert out == expected(decoder, one, message)
        if dice.random() < 0.02:
            worker.keep()
            store.commit()
    worker.keep()
    assert store.get_bytes(MEMORY) == one.to_bytes()
    return rejected


def test_a_worker_survives_mutants_and_learns_what_it_accepts_as_a_group_alone_does(known, honest):
    assert survive(known, honest, MUTANTS, 1) > LIKELY_BAD * MUTANTS


@pytest.mark.soak
@pytest.mark.timeout(3_600)
def test_a_worker_survives_a_hundred_thousand_mutants(known, honest):
    assert survive(known, honest, 100_000, 2) > LIKELY_BAD * 100_000
