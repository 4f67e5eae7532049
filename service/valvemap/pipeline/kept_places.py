"""The places of a valve as stored in a checkpoint. Pure."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError
from valvemap.pipeline.kernels import place_layout as layout
from valvemap.pipeline.kernels.place_layout import Record
from valvemap.vocabulary.statuses import Adaptation

_KEY: Final = "places 1"
_MOST: Final = 2.0**53  # largest count that a float represents exactly


def pack(record: Record, m: int, estimators: Mapping[str, str]) -> bytes:
    """Pack the places of one valve; ``estimators`` are the names and hashes of its E lanes."""
    arrays = {name: array[m] for name, array in record._asdict().items()}
    return _Kept(**arrays, estimators=named(estimators)).to_bytes(_KEY)


def unpack(data: bytes, blank: Callable[[int], Record]) -> tuple[Record, list[str]]:
    """Return the places of one valve, without the axis of valves, and the `named` estimators.

    ``blank`` makes a record of that number of estimators, and one valve.

    Raises
    ------
    StateMismatchError
        if the bytes are damaged, or their content is invalid.
    """
    kept = _Kept.from_bytes(data, _KEY)
    estimators = np.asarray(kept.estimators).tolist()
    if not isinstance(estimators, list):
        raise StateMismatchError("estimators is no list")
    like = {name: array[0] for name, array in blank(len(estimators))._asdict().items()}
    kept.check(_Kept(**like, estimators=kept.estimators))
    return Record(*(getattr(kept, name) for name in Record._fields)), estimators


def named(estimators: Mapping[str, str]) -> NDArray[np.str_]:
    """Return the estimators, each by name and hash."""
    return np.array([f"{name} {key}" for name, key in estimators.items()], np.str_)


@dataclass(frozen=True)
class _Kept(State):
    """The places of one valve as stored in a checkpoint; ``estimators`` (E,) are named by hash."""

    axes: Any
    valves: Any
    seen: Any
    points: Any
    places: Any
    lanes: Any
    estimators: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        every = slice(None)
        axes = Contents(self.axes)
        axes.within(-layout.LARGEST, layout.LARGEST, (every, [layout.LOW, layout.HIGH]))
        axes.within(layout.NARROWEST_U, layout.LARGEST, (every, layout.WIDTH))
        axes.or_infinite((every, [layout.LOWER, layout.HIGHER]))
        valves = Contents(self.valves).within(0.0, _MOST)
        valves.within(-layout.LARGEST, layout.LARGEST, layout.MEAN_Q)
        valves.within(0.0, 4.0 * layout.LARGEST**2, layout.VARIANCE_Q)
        valves.within(-1.0, layout.PLACES - 1.0, layout.NOW)
        points = Contents(self.points).or_nan((every, layout.AT_T))
        positive = every, every, [layout.JUDGED, layout.SQUARE, layout.STD]
        places = Contents(self.places).within(0.0, where=positive)
        lanes = Contents(self.lanes).within(0.0).or_infinite((every, layout.SCORE))
        lanes.within(-layout.LARGEST, layout.LARGEST, (every, layout.NEWEST))
        lanes.within(1.0 / layout.WIDEST, layout.WIDEST, (every, layout.MULTIPLE))
        lanes.within(0.0, max(Adaptation), (every, layout.FIT))
        lanes.within(0.0, 2.0, (every, layout.CHOSEN))
        return {"axes": axes, "valves": valves, "points": points, "places": places, "lanes": lanes}
