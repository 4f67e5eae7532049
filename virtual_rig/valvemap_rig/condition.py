"""Condition of a valve and its oil: the state that the flow map depends on."""

from typing import NamedTuple

import numpy as np

from valvemap_rig.faults import Faults, edge_factor, temperature_rise, worn_gap


class Condition(NamedTuple):
    """A valve at one moment.

    Attributes
    ----------
    edge_factor
        Flow of the main edge over that of the new valve.
    gap
        Flow coefficient of a gap worn into it, l/min per √bar.
    temperature_rise
        Of the tank, K.
    """

    edge_factor: float = 1.0
    gap: float = 0.0
    temperature_rise: float = 0.0


AS_NEW = Condition()


def condition(faults: Faults, index: int, rate: float) -> Condition:
    """The condition of a valve at sample number ``index``.

    >>> condition((), 0, 100.0) == AS_NEW
    True
    """
    at = np.array([index])
    return Condition(
        float(edge_factor(faults, at, rate)[0]),
        float(worn_gap(faults, at, rate)[0]),
        float(temperature_rise(faults, at, rate)[0]),
    )
