"""What the kernels of `FlowMap` share of one valve: its arrays, and the places in them."""

from typing import NamedTuple

import numpy as np

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels.flow_begun import Begun
from valvemap.model.kernels.flow_cells import Cells
from valvemap.model.kernels.flow_slopes import Slopes
from valvemap.model.samples import Floats, Singles, Times

# Places in `counters`.
USED, NEXT_FIT, FITTED, FITS, NEXT_START = 0, 1, 2, 3, 4
CLOCK = 5  # ns; of the last stay on either side of U = 0: two places
STAY_CELL, STAY_SIDE, STAY_TIME, SKIPPED = 7, 8, 9, 10
CHANGES, CHANGE_SAMPLE, CHANGE_TIME, ALARMED, STAYS, BEGAN = 11, 12, 13, 14, 15, 16
# STAYS: of one visit; BEGAN: samples when the map began again
ROWS_SEEN, LAST_TIME, NEXT_LOOK, CENSORED = 17, 18, 19, 20  # rows of `recent` so far; ns; samples
WATCHED = 21  # rows of `recent` that were searched for a least flow
CHANGE_KIND = 22  # of the last change: model of `flow_drift`, plus NAMED where U < 0
DOUBTED = 23  # what may be the meter's end: nothing, A_CHANGE or A_GUESS
CALM = 24  # samples until which what moves is found again, and is no news
RESTARTED = 25  # samples when the map began again, those that it then learnt once more included
WANDERED = 26  # ns; of the last stay that something without a name explained
PAIR_CELL, PAIR_TIME = 27, 28  # of the stay that is to be compared
LEARNT = 29  # rows of `recent` that were learnt; the others wait for signals that are held
BLOCKED = 30  # whether the last sample showed no flow where there surely was some
BEGAN_TIME = 31  # ns; of the map's first sample, 0: it has none
WEIGHED = 32  # rows seen when rivals of the operators in use were weighed
COUNTERS = 33

A_CHANGE, A_GUESS = 1, 2  # one that was called; one that flows at new places refute

# Places in `rivals`: log likelihood over the operators in use; from then on parameters.
RIVAL_SUM, RIVAL_PARAMETERS = 0, 1

# Places in `stay`: samples; sums of residuals, derivatives and variances of the map.
SAMPLES, RESIDUAL, OF_MAP = 0, 1, 2
APART = 3  # sum of squared distances from the cell's mean, in cells
BY = 4  # sums of derivatives, drifts.RATES places
KNOWN_COUNT = BY + drifts.RATES  # from here on what the cell knew when the stay began
KNOWN_OFF, CHANGE_SIZE, CHANGE_OF = KNOWN_COUNT + 1, KNOWN_COUNT + 2, KNOWN_COUNT + 3
BEFORE = KNOWN_COUNT + 4  # gain and edge of each side before a change; CHANGE_OF: how much it was
KNOWN_Z = BEFORE + 2 * drifts.LEVELS  # effects of T on what the cell knew
LOOSE = KNOWN_Z + drifts.RATES - drifts.LEVELS  # sum of variances of signals between two values
NOISY = LOOSE + 1  # sum of variances of the noise
STAY = NOISY + 1


class Memory(NamedTuple):
    """One valve's arrays; see `FlowMapState`."""

    cells: Cells
    slopes: Slopes
    begun: Begun
    theta: Singles
    std: Singles
    doubt: Singles
    scalars: Floats
    counters: np.ndarray
    x: Floats
    P: Floats
    chance: Floats
    now: Floats
    stay: Floats
    wear: Floats
    play: Floats
    path: Floats
    rivals: Singles
    recent: Singles


class Batch(NamedTuple):
    """Samples, and what is found of them; all (N,)."""

    t: Times
    U: Floats
    dp: Floats
    p1: Floats
    T: Floats
    Q: Floats
    usable: np.ndarray
    predicted: Floats
    residual: Floats
    status: np.ndarray
    longest: float  # samples that a cell remembers


class Room(NamedTuple):
    """Room to work in: (4, 3); see `Drift`; (AT,); see `flow_meter.metered`, (8,)."""

    work: Floats
    drift: Floats
    at: Floats
    means: Floats


# Places in `Room.at`: what the map says at one point.
FLOW, SURE, TOTAL, PLACE_U, PLACE_S, SLOPE, WARM, OF = 0, 1, 2, 3, 4, 5, 6, 7
FLOWS = OF + drifts.RATES  # derivatives at another temperature
AS_LEARNT = FLOWS + drifts.RATES  # flow due to T at which cells learnt
MOVED = AS_LEARNT + 1  # variance by what moves in time, without that by T
AGAINST = MOVED + 1  # flow against Δp, which the map has there and the valve cannot have
AT = AGAINST + 1
# From OF on derivatives by the states of `flow_drift`; WARM: flow due to T.
