"""The times of a live service."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LiveSettings:
    """Times in s.

    Attributes
    ----------
    stale_after_s : float
        Without a sample for this long, a valve's sensors are lost and its results Bad. If the
        newest sample is older than this by the source's clock, results are Uncertain; if it is OLD
        times as old, Bad.
    reorder_s : float
        Longest time that a sample waits in the reorder buffer for earlier samples.
    checkpoint_interval_s, map_interval_s : float
        Longest interval between checkpoints of a valve (few valves: every second), and interval
        at which the inverse tables are recomputed.
    publish_budget_s : float
        Longest time that publishing may delay the next batch. Valves that exceed the budget are
        published first next time, with their newest results.
    publish_share : float
        Largest share of the time spent on publishing while results wait: incoming samples have
        priority over outgoing results. See
        :class:`~valvemap.runtime.publishing_turns.PublishingTurns`.
    certificate_until_ns : int
        Expiry of the service's certificate, UTC ns; 0: no persistent certificate.
    """

    stale_after_s: float = 2.0
    reorder_s: float = 1.0
    checkpoint_interval_s: float = 10.0
    map_interval_s: float = 1.0
    publish_budget_s: float = 0.02
    publish_share: float = 0.25
    certificate_until_ns: int = 0
