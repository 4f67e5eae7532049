"""Lanes as stored in checkpoints. Pure."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Self, cast

import numpy as np

from valvemap.model.capabilities import Forgetful
from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError, Template, key_of
from valvemap.model.kernels import lack_of_fit
from valvemap.model.kernels import residual_spread as of_spread
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.support import Support
from valvemap.pipeline.kernels import score as of_score
from valvemap.pipeline.score import Score
from valvemap.pipeline.valve_state import AnyEstimator, Lane, fresh_lane, with_forgetting

WIDEST = 1e9  # largest ratio of an interval to its root mean square: outliers raise both

_OF_SCORE = [  # never negative
    *(of_score.N, of_score.SQUARES, of_score.SCATTER_Q),
    *(of_score.RECENT, of_score.WEIGHT, of_score.LARGEST),
]


@dataclass(frozen=True)
class _Kept(State):
    """A lane as stored in a checkpoint."""

    state_version: ClassVar[int] = 3  # 2 stored residuals in double precision

    estimator: Any
    score: Any
    cells: Any
    stamps: Any
    ages: Any
    overall: Any
    seen: Any
    fit: Any
    ranges: Any
    count: Any

    @classmethod
    def of(cls, lane: Lane, packed: bytes) -> Self:
        """Build it from a lane, and its estimator's state as bytes."""
        spread, support = lane.spread, lane.support
        return cls(
            estimator=np.frombuffer(packed, np.uint8),
            score=lane.score.sums,
            cells=spread.cells,
            stamps=spread.stamps,
            ages=spread.ages,
            overall=spread.overall,
            seen=support.cells,
            fit=support.fit,
            ranges=support.ranges,
            count=np.array(lane.count),
        )

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        score = Contents(self.score).within(0.0, where=_OF_SCORE)
        score.or_infinite([of_score.LOWEST_Q, of_score.HIGHEST_Q])
        overall = Contents(self.overall).within(0.0)
        multiples = slice(of_spread.QUANTILE, of_spread.TIMES)
        return {
            "score": score,
            "cells": Contents(self.cells).within(0.0),
            "ages": Contents(self.ages).within(0, of_spread.AGES),
            "overall": overall.within(0.0, WIDEST, multiples),
            "fit": Contents(self.fit).within(0.0, where=slice(lack_of_fit.SEEN, None)),
        }

    def is_coherent(self) -> bool:
        """Whether each range is non-empty."""
        U_low, U_high, dp_low, dp_high, Q_max = self.ranges.tolist()
        return bool(U_low < U_high and dp_low < dp_high and Q_max > 0.0)


def lane_to_bytes(lane: Lane, key: str) -> bytes:
    """Pack a lane; ``key`` is that of the configured estimator, without operators' settings."""
    return _Kept.of(lane, lane.state.to_bytes(key)).to_bytes(key)


def lane_from_bytes(
    data: bytes, configured: AnyEstimator, lam: float | None, *, frozen: bool, t: int
) -> Lane:
    """Unpack a lane.

    Raises
    ------
    StateMismatchError
        if the bytes belong to another estimator or other hyper-parameters, or their content is
        invalid.
    """
    key, kind, of_state, of_lane = _templates(cast("Hashable", configured))
    kept = _Kept.from_bytes(data, key)
    of_lane.check(kept)
    state = kind.from_bytes(kept.estimator.tobytes(), key)
    of_state.check(state)
    score = Score(kept.score)
    spread = ResidualSpread(kept.cells, kept.stamps, kept.ages, kept.overall)
    support = Support(kept.seen, kept.fit, kept.ranges)
    lane = Lane(configured, state, score, spread, support, frozen, count=int(kept.count), t=t)
    if lam is None:
        return lane
    if not isinstance(configured, Forgetful):
        raise StateMismatchError(f"a forgetting factor {lam!r}, and none is used")
    try:
        return with_forgetting(lane, lam)
    except ValueError as error:
        raise StateMismatchError(str(error)) from None


@lru_cache(maxsize=64)
def _templates(configured: Hashable) -> tuple[str, type[State], Template, Template]:
    """Return the estimator's hash, the type of its states, and templates to check them against."""
    estimator = cast("AnyEstimator", configured)
    key, fresh = key_of(estimator), fresh_lane(estimator)
    packed = _Kept.of(fresh, fresh.state.to_bytes(key))
    return key, type(fresh.state), Template(fresh.state), Template(packed)
