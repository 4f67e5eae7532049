"""Aggregates against node-opcua's, on the same values."""

import json
import subprocess

import numpy as np
import pytest

from guarded_opcua import Records
from guarded_opcua.history.aggregate_kinds import Aggregate
from guarded_opcua.history.aggregates import Aggregation
from guarded_opcua.history.intervals import Intervals, Rules
from support import node_peer

pytestmark = pytest.mark.node

MS, T0 = 1_000_000, 1_800_000_000_000  # ns, ms
GOOD, UNCERTAIN, BAD = 0, 0x408F0000, 0x80890000
WIDTH, INTERVALS = 1_000, 40  # ms
ALL_STATED = 0xFFFF001F  # all but the kind of information, which node-opcua does not state
THEIRS = (  # node-opcua has no others
    *(Aggregate.INTERPOLATIVE, Aggregate.AVERAGE, Aggregate.MINIMUM, Aggregate.MAXIMUM),
    *(Aggregate.COUNT, Aggregate.DURATION_GOOD, Aggregate.DURATION_BAD),
    *(Aggregate.PERCENT_GOOD, Aggregate.PERCENT_BAD),
)
OF_STATUS = THEIRS[5:]
SEVERITY_AND_BITS = 0xC000001F  # drawn from an Uncertain value, its sub-code is mixed with another


@pytest.fixture(scope="module")
def theirs(request):
    command = node_peer.program(request.config.cache.mkdir("node_peer"), "aggregates.cjs")
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:

        def ask(**asked):
            process.stdin.write(json.dumps(asked) + "\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield ask
        process.stdin.close()


def past(seed, doubtful):
    """Some values in each interval, none at its start, no two of them equal."""
    rng = np.random.default_rng(seed)
    ms = [
        k * WIDTH + np.sort(rng.choice(np.arange(1, WIDTH - 1), rng.integers(2, 8), replace=False))
        for k in range(-1, INTERVALS + 1)
    ]
    t = T0 + np.concatenate(ms)
    values = rng.permutation(len(t)) / 8.0
    codes = rng.choice([GOOD, BAD, UNCERTAIN] if doubtful else [GOOD], len(t))
    return t, values, codes


@pytest.mark.parametrize("doubtful", [False, True], ids=["good", "doubtful"])
@pytest.mark.parametrize("aggregate", THEIRS)
@pytest.mark.parametrize("seed", range(5))
def test_they_agree_to_the_status_bit(theirs, aggregate, doubtful, seed):
    t, values, codes = past(seed, doubtful)
    stated = SEVERITY_AND_BITS if aggregate is Aggregate.INTERPOLATIVE else ALL_STATED
    rules = Rules(treat_uncertain_as_bad=False)
    asked = theirs(
        aggregate=aggregate.name,
        past=[list(row) for row in zip(t.tolist(), values.tolist(), codes.tolist(), strict=True)],
        start=T0,
        end=T0 + INTERVALS * WIDTH,
        width=WIDTH,
        stepped=False,
        rules={
            "percentBad": rules.percent_bad,
            "percentGood": rules.percent_good,
            "treatUncertainAsBad": rules.treat_uncertain_as_bad,
            "sloped": rules.sloped,
        },
    )
    start = T0 * MS
    intervals, _ = Intervals.of(start, start + INTERVALS * WIDTH * MS, WIDTH * MS, most=1_000)
    ours = Aggregation(aggregate, intervals, rules, stepped=False)
    ours.take(Records(values, codes.astype(np.uint32), t * MS, t * MS))
    found = ours.records()
    number = np.searchsorted(intervals.edges, t * MS, side="right") - 1
    for k, (ms, value, code) in enumerate(asked):
        if aggregate in OF_STATUS and not (codes[number == k] == GOOD).any():
            continue  # theirs is no duration then
        assert found.source[k] == ms * MS
        assert hex(found.codes[k] & stated) == hex(code & stated)
        if value is not None and found.codes[k] < 0x80000000:
            assert found.values[k] == pytest.approx(value, rel=1e-12)
