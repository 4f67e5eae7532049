"""A valve with ports in a simulated world: its line A and the two edges of it, as three valves."""

import numpy as np

from valvemap.pipeline.edges import Part
from valvemap.vocabulary.edges import Edge
from valvemap.vocabulary.signals import Signal

PARTS = (Part("V", "A"), Part("V", "A", Edge.PA), Part("V", "A", Edge.AT))
NAMES = ("V.LineA", "V.PA", "V.AT")
LINE = 0
_ON_A_SIDE = 5  # samples; U then changes its sign: an edge that has just opened is not learnt from
_GAINS = {1: 0.14, -1: 0.11}  # of both edges, l/min/%/√bar


def give_signals(server, rng):
    """Give the three rows the signals of one line: U and flow are shared, the pressures differ."""
    n = len(server.at)
    noise = np.random.default_rng(rng.getrandbits(64))
    side = np.repeat(noise.choice((-1.0, 0.0, 1.0), n), _ON_A_SIDE)[:n]
    U = side * noise.uniform(10.0, 100.0, n)
    pP, pA, pT = np.full(n, 180.0), noise.uniform(20.0, 160.0, n), np.full(n, 4.0)
    pB = noise.uniform(20.0, 160.0, n)
    drop = np.where(U > 0.0, pP - pA, pA - pT)
    gain = np.where(U > 0.0, _GAINS[1], _GAINS[-1])
    Q = gain * U * np.sqrt(drop) - 0.01 * (pA - pB) + noise.normal(0.0, 0.3, n)
    for valve, (p1, p2) in zip(server.case.valves, ((pA, pB), (pP, pA), (pA, pT)), strict=True):
        values = server.values[valve]
        for signal, column in ((Signal.U, U), (Signal.P1, p1), (Signal.P2, p2), (Signal.Q, Q)):
            values[:, signal] = column
