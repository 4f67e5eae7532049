"""Errors of the newest maps at places left: what of them is noise, misfit, or drift. Pure."""

import math
from typing import Final

import numpy as np

from valvemap.model.samples import Flags, Floats
from valvemap.pipeline.kernels import place_layout as layout
from valvemap.pipeline.kernels.place_layout import Record
from valvemap.pipeline.kernels.places import ENOUGH, GAUSSIAN, MISSES
from valvemap.pipeline.map_errors import shown_std
from valvemap.vocabulary.statuses import Adaptation

LOST: Final = 4.0  # times the variance of Q over places; a larger mean squared error is useless
FEWEST_PLACES: Final = 8  # places; with fewer, nothing is recommended
CERTAIN: Final = 3.0  # standard errors by which errors exceed the noise before intervals widen
OUTLYING_ALL, OUTLYING = 100.0, 25.0  # times the median square, of all and of one; larger: clipped
EXACT: Final = 1e-30  # (l/min)²; the square of a map without errors: 0 is one not evaluated
LATEST: Final = 0.05  # share of an earlier squared error that a later look back leaves at least
CLEARLY: Final = 2.0  # times; a squared error larger than another by this is another kind


def note_past(
    record: Record,
    m: int,
    e: int,
    known: Flags,
    Q: Floats,
    errors: Floats,
    squares: Floats,
    std: Floats,
    least: float,
) -> None:
    """Store one estimator's errors at places left, and what of them is not noise."""
    lane, square, P = record.lanes[m, e], float(squares.mean()), len(errors)
    determined = np.isfinite(square)
    if not determined:
        lane[[layout.PAST_SQUARE, layout.PAST_NOISE, layout.EXCESS, layout.LOST]] = 0.0
        return
    noise = _noise(record, m, e, known, errors, square, least)
    excess = square - noise if square > noise * (1.0 + CERTAIN * np.sqrt(2.0 / P)) else 0.0
    rank = math.ceil((1.0 - MISSES) * P) - 1
    quantile = float(np.partition(np.abs(errors), rank)[rank])
    tail = max(quantile / (GAUSSIAN * np.sqrt(square)), 1.0) if square > 0.0 else 1.0
    excess = max(excess, LATEST * float(lane[layout.EXCESS]))
    lane[layout.PAST_SQUARE] = max(square, LATEST * lane[layout.PAST_SQUARE], EXACT)
    lane[layout.PAST_NOISE], lane[layout.EXCESS], lane[layout.TAIL] = noise, excess, tail
    lane[layout.LOST] = float(P >= FEWEST_PLACES and square > LOST * float(np.var(Q)))
    place = record.places[m, e]
    place[known, layout.PAST] = errors
    shown = np.fmax(std, shown_std(errors**2, noise, excess, tail))
    place[known, layout.STD] = np.nan_to_num(shown, nan=0.0, posinf=0.0)


def diagnose(record: Record, m: int, least: float) -> None:
    """Explain the errors of each map at the places left.

    Errors beyond the noise that another map does not have are misfit. The best map misfits,
    too, if it predicted these places as badly before; else the valve has moved since.
    """
    lanes = record.lanes[m]
    for e, lane in enumerate(lanes):
        if lane[layout.PAST_SQUARE] == 0.0:
            lane[layout.FIT] = Adaptation.UNDECIDED
        elif lane[layout.EXCESS] == 0.0:
            lane[layout.FIT] = Adaptation.STEADY
        elif lane[layout.PAST_SQUARE] > CLEARLY * least:
            lane[layout.FIT] = Adaptation.MISFIT
        else:
            place = record.places[m, e]
            judged = place[:, layout.JUDGED] > 0.0
            again = float(place[judged, layout.SQUARE].mean()) if judged.any() else 0.0
            stays = again - lane[layout.PAST_NOISE] > lane[layout.EXCESS] / CLEARLY
            lane[layout.FIT] = Adaptation.MISFIT if stays else Adaptation.DRIFT


def clipped(errors: Floats) -> Floats:
    """Squares of errors (E, P), outliers clipped: a spike would decide alone."""
    squares = errors**2
    if not np.isfinite(squares).any():
        return squares
    of_all = np.median(np.nanmin(np.where(np.isfinite(squares), squares, np.inf), axis=0))
    of_each = np.median(squares, axis=1, keepdims=True)
    clipped: Floats = np.minimum(squares, np.fmax(OUTLYING_ALL * of_all, OUTLYING * of_each))
    return clipped


def _noise(
    record: Record, m: int, e: int, known: Flags, errors: Floats, square: float, least: float
) -> float:
    """Return the variance of the measurement noise, no larger than the errors' mean square.

    It is seen in the residuals' differences from sample to sample at one place, and in the
    errors of the best estimator. Otherwise, in the differences between neighbouring places.
    """
    lane, found = record.lanes[m, e], square
    if lane[layout.NOISE_N] > ENOUGH:
        found = min(found, float(lane[layout.NOISE]))
    elif square <= least:
        grid = np.full(layout.PLACES, np.nan)
        grid[known] = errors
        shape = layout.PLACES_U, layout.PLACES_S, layout.PLACES_T
        steps = np.diff(grid.reshape(shape), axis=0)
        if np.isfinite(steps).any():
            found = min(found, float(np.nanmean(steps**2)) / 2.0)
    return min(found, least) if square > least else found
