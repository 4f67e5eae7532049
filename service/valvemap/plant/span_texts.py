"""Spans as comments state them: ``4-20 mA = 0-400 bar``, ``0..27648 = 0…250 bar``."""

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from valvemap.pipeline.units import Quantity, Unit
from valvemap.plant.unit_texts import known_unit

_NUMBER: Final = r"[-+]?\d+(?:[.,]\d+)?"
_SPAN = re.compile(
    rf"(?<![\w.])(?P<low>{_NUMBER})\s*(?P<of_low>[a-zA-Z%°]+)?\s*"
    r"(?:\.{2,3}|…|-|–|~|/|to|bis|hasta|fino a|à|a|至|到)\s*"
    rf"(?P<high>\+?{_NUMBER})\s*(?P<unit>%|°?[a-zA-Z]+[\d²³]?(?:\s?/\s?[a-zA-Z]+)?|[\u4e00-\u9fff]+)?"
)


@dataclass(frozen=True)
class Span:
    """Two numbers and their unit; None if it is none of ours."""

    low: float
    high: float
    unit: Unit | None

    @property
    def ends(self) -> tuple[float, float]:
        """Both numbers."""
        return self.low, self.high

    @property
    def is_raw(self) -> bool:
        """Whether it is that of an electrical signal, or of counts."""
        return self.unit is None or self.unit.quantity is Quantity.ELECTRICAL


def spans_in(text: str) -> Iterator[Span]:
    """Yield the spans in a text.

    >>> [(s.ends, s.unit and s.unit.symbol) for s in spans_in("4-20 mA = 0...400 bar")]
    [((4.0, 20.0), 'mA'), ((0.0, 400.0), 'bar')]
    >>> [s.ends for s in spans_in("0..27648: 0 bis 2,5 MPa, S7-1500, 2024-11-27")]
    [(0.0, 27648.0), (0.0, 2.5)]
    """
    plain = unicodedata.normalize("NFKC", text).replace("...", "..")
    for found in _SPAN.finditer(plain):
        low, high = (float(found[end].replace(",", ".")) for end in ("low", "high"))
        if low < high:
            yield Span(low, high, known_unit(found["unit"] or ""))


def raw_and_scaled(text: str, quantity: Quantity) -> tuple[Span, Span] | None:
    """Return the raw span in a text and the values of a quantity that it stands for, if any.

    >>> raw, scaled = raw_and_scaled("uscita 0..27648 = 0..100 %", Quantity.OPENING)
    >>> raw.ends, scaled.ends
    ((0.0, 27648.0), (0.0, 100.0))
    """
    for one, other in pairwise(spans_in(text)):
        raw, scaled = (one, other) if one.is_raw else (other, one)
        if raw.is_raw and scaled.unit is not None and scaled.unit.quantity is quantity:
            return raw, scaled
    return None
