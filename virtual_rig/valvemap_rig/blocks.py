"""Blocks of simulated samples: what the sensors show, and the truth."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from valvemap_rig.faults import SIGNALS, Signal
from valvemap_rig.machine_simulation import MachineBlock
from valvemap_rig.records import Floats


@dataclass(frozen=True)
class ValveBlock:
    """N samples of one valve, all arrays of shape (N,).

    ``t`` (int64, UTC ns in multiples of 100) is the source time, wrong clock included; ``U`` (%),
    ``p1``, ``p2`` (bar), ``Q`` (l/min) and ``T`` (°C) are what the sensors show; ``status``
    (uint32, OPC UA StatusCodes) and ``present`` (bool; False = not sent) go by signal. The rest
    is the truth, without noise: ``T_true`` at the inlet, ``Q_true`` as the meter counts it.
    """

    t: NDArray[np.int64]
    U: Floats
    p1: Floats
    p2: Floats
    Q: Floats
    T: Floats
    status: Mapping[Signal, NDArray[np.uint32]]
    present: Mapping[Signal, NDArray[np.bool_]]
    U_true: Floats
    dp_true: Floats
    T_true: Floats
    Q_true: Floats

    def column(self, signal: str) -> Floats:
        """Return a signal as its sensor shows it."""
        column: Floats = getattr(self, signal)
        return column

    def quality(self, signal: str) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
        """Return a signal's status, and whether it is sent."""
        own = next(name for name in SIGNALS if name == signal)
        return self.status[own], self.present[own]


@dataclass(frozen=True)
class RigBlock:
    """N samples of every valve and machine.

    ``sequence`` (uint32) is the sample's number modulo 2³², ``t`` (int64, UTC ns in multiples of
    100) its time by a clock that is right; all share both.
    """

    sequence: NDArray[np.uint32]
    t: NDArray[np.int64]
    valves: Mapping[str, ValveBlock]
    machines: Mapping[str, MachineBlock] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.sequence)
