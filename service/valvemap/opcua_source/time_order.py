"""Puts the changes of one message into the order of time. Pure.

Servers send what waited signal by signal (Part 4, 5.13.1.5). After an interruption one message
spans many seconds; in its own order, each value of the later signals would come too late.
"""

from typing import Final

import numpy as np

from valvemap.model.samples import Times
from valvemap.pipeline.data_changes import DataChanges

AS_SENT_NS: Final = 250_000_000  # below, order does not matter: scans wait four times as long


def in_order_of_time(changes: DataChanges) -> DataChanges:
    """Return N changes in the order of their source times; those of one item keep their order.

    A value whose time steps back, as when the source's clock is set, follows its predecessor.

    Examples
    --------
    >>> import numpy as np
    >>> sent = DataChanges(
    ...     item=np.array([0, 0, 1, 1], np.int32),
    ...     value=np.array([1.0, 2.0, 3.0, 4.0]),
    ...     status=np.zeros(4, np.uint32),
    ...     source_time=np.array([0, 10**9, 5, 10**9 + 5]),
    ... )
    >>> in_order_of_time(sent).value.tolist()
    [1.0, 3.0, 2.0, 4.0]
    """
    t = changes.source_time
    if not len(t) or int(t.max()) - int(t.min()) <= AS_SENT_NS:
        return changes
    return changes[np.argsort(_newest_of_item(changes.item.astype(np.int64), t), kind="stable")]


def _newest_of_item(item: Times, t: Times) -> Times:
    """Rank of the newest time of the same item up to each change, (N,)."""
    _, rank = np.unique(t, return_inverse=True)
    by_item = np.argsort(item, kind="stable")
    first = item[by_item] * len(t)
    newest = np.maximum.accumulate(first + rank[by_item]) - first
    found = np.empty_like(newest)
    found[by_item] = newest
    return found
