"""Abrupt changes of the plant, as detected by an estimator."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Change:
    """An abrupt change of the plant.

    Attributes
    ----------
    count : int
        Number of changes detected, including this one.
    sample : int
        Number of the first sample (of those used, from 0) after the change, as estimated.
    t : int
        Time of the last sample before it, UTC ns.
    size : float
        Change of the flow, l/min: of least squares the mean innovation until its detection, of
        `Auto` the root mean square of the distance from the former map within 10 s, with its sign.
    """

    count: int
    sample: int
    t: int
    size: float
