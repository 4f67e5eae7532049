"""The work on an axis that takes long: the solution of its sums, and the watch's windows. Pure.

The caller runs a job in another thread. The third one is the search for play and spool
(:func:`~valvemap.model.axis_search.identify`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.model.axis import AxisRegression, AxisSamples, AxisState
from valvemap.model.axis_fit import AxisFit, fit, moved
from valvemap.model.axis_inverse import AxisTable, axis_table
from valvemap.model.axis_search import AxisResult
from valvemap.model.samples import Floats
from valvemap.pipeline.axis_ports import AxisMap
from valvemap.pipeline.axis_watch import AxisWatch, Balance, balance

_RATED_BAR: Final = 70.0


@dataclass(frozen=True)
class Known:
    """The solution of the sums: the fit, the table that is searched, and the map that is shown.

    ``sums`` is the fit of the sums alone, ``fit`` the edges as they are now. ``forces`` is the
    balance of forces, when a watch is to begin.
    """

    sums: AxisFit
    fit: AxisFit
    table: AxisTable
    map: AxisMap
    forces: Balance | None


@dataclass(frozen=True)
class Weighed:
    """A watch before and after its closed windows were weighed."""

    before: AxisWatch
    after: AxisWatch


Outcome = AxisResult | Known | Weighed
Job = Callable[[], Outcome]


def solved(
    regression: AxisRegression,
    state: AxisState,
    of_shape: Floats,
    window: AxisSamples | None = None,
) -> Known:
    """Return the solution of a state; with a window, also the balance of forces there."""
    sums = fit(regression, state)
    sums = replace(sums, covariance=sums.covariance + of_shape)
    found = moved(sums, state)
    table = axis_table(found)
    return Known(
        sums,
        found,
        table,
        AxisMap(
            bulk_modulus=found.bulk_modulus,
            leakage=found.leakage,
            air=found.air,
            play_percent=regression.play_percent,
            spool_hz=regression.spool_hz,
            U=table.y,
            flow=table.flow(_RATED_BAR),
            flow_std=table.spread * np.sqrt(_RATED_BAR),
            known=table.known,
        ),
        None if window is None else balance(found, window),
    )


def weighed(watch: AxisWatch) -> Weighed:
    """Weigh the closed windows of a watch."""
    return Weighed(watch, watch.weighed())
