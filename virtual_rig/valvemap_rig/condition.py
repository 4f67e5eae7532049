"""Condition of a valve and its oil, on which the flow map depends."""

from typing import NamedTuple

import numpy as np

from valvemap_rig.fault_effects import Faults, edge_factor, temperature_rise, worn_gap


class Condition(NamedTuple):
    """Condition of a valve at one sample.

    Attributes
    ----------
    edge_factor
        Flow of the main edge relative to the new valve.
    gap
        Flow coefficient of a gap worn into the main edge, l/min per √bar.
    temperature_rise
        Rise of the tank temperature, K.
    """

    edge_factor: float = 1.0
    gap: float = 0.0
    temperature_rise: float = 0.0


AS_NEW = Condition()


def condition(faults: Faults, index: int, rate: float) -> Condition:
    """Return the condition of a valve at sample number ``index``.

    >>> condition((), 0, 100.0) == AS_NEW
    True
    """
    at = np.array([index])
    return Condition(
        float(edge_factor(faults, at, rate)[0]),
        float(worn_gap(faults, at, rate)[0]),
        float(temperature_rise(faults, at, rate)[0]),
    )
