"""When an axis searches play and spool: by its movement, and by what the searches found. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State

SEARCHES_S: Final = (70.0, 140.0, 210.0)  # s of movement until the first searches
AGAIN_S: Final = 600.0  # s of movement between two later searches
REFUSED_AGAIN_S: Final = 30.0  # s of movement after a refused search; doubled by each further one
_MOST_REFUSED: Final = 10


@dataclass(frozen=True)
class Searches:
    """The searches so far; all times in s of movement.

    Attributes
    ----------
    found
        Searches that found play and spool.
    refused
        Searches refused since the last of them.
    left_s
        Movement until the next search.

    Examples
    --------
    >>> Searches().after(70.0).is_due
    True
    >>> Searches().succeeded().left_s
    70.0
    """

    found: int = 0
    refused: int = 0
    left_s: float = SEARCHES_S[0]

    @property
    def is_due(self) -> bool:
        """Whether a search is due."""
        return self.left_s <= 0.0

    @property
    def are_settled(self) -> bool:
        """Whether play and spool are settled."""
        return self.found >= len(SEARCHES_S)

    def after(self, moved_s: float) -> Self:
        """Return them after so much movement."""
        return replace(self, left_s=self.left_s - moved_s)

    def succeeded(self) -> "Searches":
        """Return them after a search that found play and spool."""
        k = self.found + 1
        left_s = SEARCHES_S[k] - SEARCHES_S[k - 1] if k < len(SEARCHES_S) else AGAIN_S
        return Searches(k, 0, left_s)

    def failed(self) -> Self:
        """Return them after a refused search: the next ones come more and more rarely."""
        left_s = min(REFUSED_AGAIN_S * 2.0**self.refused, AGAIN_S)
        return replace(self, refused=min(self.refused + 1, _MOST_REFUSED), left_s=left_s)

    def abandoned(self) -> Self:
        """Return them after a search without an outcome."""
        return replace(self, left_s=AGAIN_S)

    def over_new_samples(self) -> Self:
        """Return them after the earlier samples were dropped, as by a sudden change.

        The next search has as many samples as the last one: fewer tell less of play and spool, and
        its sums would know fewer places than those it replaces.

        >>> Searches(found=3).over_new_samples().left_s
        210.0
        """
        last = min(max(self.found, 1), len(SEARCHES_S)) - 1
        return replace(self, left_s=SEARCHES_S[last])

    def resumed(self) -> Self:
        """Return them after a restart, which drops the samples of the window.

        The next search has as many samples as it would have had. The last of the first ones is
        repeated: findings begin behind it, and need its samples.
        """
        found = min(self.found, len(SEARCHES_S) - 1)
        return replace(self, found=found, left_s=max(self.left_s, SEARCHES_S[found]))

    def to_bytes(self, key: str) -> bytes:
        """Pack them, bound to ``key``."""
        numbers = (np.array(value) for value in (self.found, self.refused, self.left_s))
        return _KeptSearches(*numbers).to_bytes(key)

    @classmethod
    def from_bytes(cls, packed: bytes, key: str) -> Self:
        """Unpack them.

        Raises
        ------
        StateMismatchError
            if they are damaged, or bound to something else.
        """
        kept = _KeptSearches.from_bytes(packed, key)
        kept.check(_KeptSearches(np.array(0), np.array(0), np.array(0.0)))
        return cls(int(kept.found), int(kept.refused), float(kept.left_s))


@dataclass(frozen=True)
class _KeptSearches(State):
    """The stored form of `Searches`."""

    found: Any
    refused: Any
    left_s: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            "found": Contents(np.asarray(self.found)).within(0, 2**53),
            "refused": Contents(np.asarray(self.refused)).within(0, _MOST_REFUSED),
            "left_s": Contents(np.asarray(self.left_s)).within(-1e9, AGAIN_S),
        }
