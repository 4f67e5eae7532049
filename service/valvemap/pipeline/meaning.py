"""What learnt states mean: the source, node, unit, scaling and accuracy of each signal.

A checkpoint carries the meaning under which it was learnt. A restart compares it with that of the
present configuration.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Final

from valvemap.pipeline.units import Scaling
from valvemap.vocabulary.signals import MEASURED

UNREADABLE: Final = "digest "
"""Begins the meaning of a checkpoint of which only the digest can be read."""

FLOW: Final = ("U", "p1", "p2", "Q")
"""The signals of every map of a valve."""
IDENTITY: Final = (*FLOW, "position", "speed", "pA", "pB", "pS", "pT")
"""The signals whose nodes identify a valve, or an axis."""
_DIGEST_BYTES = 16


@dataclass(frozen=True)
class SignalMeaning:
    """One signal: ``inside = gain · value + offset``; ``unit`` describes that in words.

    ``accuracy`` is the limit ± of the sensor's error in the internal unit; 0: none is stated.
    """

    node: str
    unit: str = ""
    gain: float = 1.0
    offset: float = 0.0
    accuracy: float = 0.0

    @property
    def scaling(self) -> Scaling:
        """From the node's numbers to the internal unit."""
        return Scaling(self.gain, self.offset)


@dataclass(frozen=True)
class Meaning:
    """All signals by name, the ``source`` that publishes them, and each λ configured.

    ``lam`` of an axis is empty: its states are valid whatever its memory.
    """

    source: str
    signals: Mapping[str, SignalMeaning]
    lam: Mapping[str, float] = field(default_factory=dict)

    @property
    def nodes(self) -> tuple[str | None, ...]:
        """The nodes of `IDENTITY`; None for a signal that there is not."""
        return tuple(self.node(name) for name in IDENTITY)

    def node(self, signal: str) -> str | None:
        """Return the node of a signal; None without one."""
        found = self.signals.get(signal)
        return None if found is None else found.node

    def to_text(self) -> str:
        """Return it as JSON with sorted keys; equal meanings have equal texts."""
        return self._text

    @cached_property
    def _text(self) -> str:
        signals = {name: vars(one) for name, one in self.signals.items()}
        whole = {"source": self.source, "signals": signals, "lam": self.lam}
        return json.dumps(whole, sort_keys=True)


def digest_of(text: str) -> str:
    """Return the digest of a meaning's text; empty of an unknown one."""
    if not text:
        return ""
    return hashlib.blake2b(text.encode(), digest_size=_DIGEST_BYTES).hexdigest()


@lru_cache(maxsize=4096)
def meaning_of(text: str) -> Meaning | None:
    """Return the meaning of a checkpoint; None if it is empty or none of this version."""
    try:
        said: dict[str, Any] = json.loads(text)
        signals = {str(name): SignalMeaning(**one) for name, one in said["signals"].items()}
        lam = {str(name): float(value) for name, value in said["lam"].items()}
        return Meaning(str(said["source"]), signals, lam)
    except (ValueError, TypeError, KeyError, AttributeError):
        return None


@dataclass(frozen=True)
class Rescaling:
    """How the internal value of a signal changes: ``new = gain · old + offset``."""

    gain: float = 1.0
    offset: float = 0.0

    @property
    def is_none(self) -> bool:
        """Whether values are unchanged."""
        return self.gain == 1.0 and self.offset == 0.0


UNCHANGED: Final = Rescaling()


def rescaling(before: Meaning, after: Meaning, signal: str) -> Rescaling:
    """Return how a signal's internal values change; none if it is not in both."""
    old, new = before.signals.get(signal), after.signals.get(signal)
    if old is None or new is None or old.scaling == new.scaling:
        return UNCHANGED
    gain = new.gain / old.gain
    return Rescaling(gain, new.offset - gain * old.offset)


def other_nodes(before: Meaning, after: Meaning, names: tuple[str, ...] = FLOW) -> str | None:
    """Return which signals come from other nodes, in words; None if none of these does."""
    changed = [name for name in names if before.node(name) != after.node(name)]
    if not changed:
        return None
    was, now = [before.node(n) for n in changed], [after.node(n) for n in changed]
    changed = [_label(name, before, after) for name in changed]
    if len(changed) > 1 and sorted(map(str, was)) == sorted(map(str, now)):
        return f"the nodes of {' and '.join(changed)} are swapped"
    first = f"{changed[0]} came from {was[0] or 'no node'}, now from {now[0] or 'no node'}"
    return first if len(changed) == 1 else f"{first}; {', '.join(changed[1:])} changed, too"


def other_scaling(before: Meaning, after: Meaning, signal: str) -> str:
    """Return the change of a signal's unit or scaling in words."""
    old, new = before.signals[signal], after.signals[signal]
    return f"{_label(signal, before, after)} was read as {old.unit}, now as {new.unit}"


def _label(signal: str, *meanings: Meaning) -> str:
    """Return the name of a signal: dp for p1 where one transmitter measures the difference."""
    is_drop = signal == "p1" and all(one.node("p2") is None for one in meanings)
    return "dp" if is_drop else signal


def other_accuracies(before: Meaning, after: Meaning) -> Iterator[str]:
    """Yield the changes of the sensors' accuracies in words."""
    for name in MEASURED:
        old, new = before.signals.get(name), after.signals.get(name)
        if old is not None and new is not None and old.accuracy != new.accuracy:
            yield f"{name} ± {old.accuracy:g} is now ± {new.accuracy:g}"
