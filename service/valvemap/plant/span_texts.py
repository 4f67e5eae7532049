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

    @property
    def is_share(self) -> bool:
        """Whether it is in %, as an opening, or as a share of another span, is."""
        return self.unit is not None and self.unit.quantity is Quantity.OPENING


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


def _is_rawer(one: Span, other: Span) -> bool:
    """Whether numbers of one span stand for those of another."""
    return not other.is_raw and (one.is_raw or (one.is_share and not other.is_share))


def raw_and_scaled(text: str, quantity: Quantity | None) -> tuple[Span, Span] | None:
    """Return the raw span in a text and the values that it stands for, if any.

    ``quantity`` is that of the values; None: any.

    >>> raw, scaled = raw_and_scaled("0-100 % = 0-400 bar", Quantity.PRESSURE)
    >>> raw.ends, scaled.ends
    ((0.0, 100.0), (0.0, 400.0))
    >>> raw, scaled = raw_and_scaled("uscita 0..27648 = 0..100 %", Quantity.OPENING)
    >>> raw.ends, scaled.ends
    ((0.0, 27648.0), (0.0, 100.0))
    """
    for one, other in pairwise(spans_in(text)):
        raw, scaled = (one, other) if _is_rawer(one, other) else (other, one)
        if not _is_rawer(raw, scaled) or scaled.unit is None:
            continue
        if quantity is None or scaled.unit.quantity is quantity:
            return raw, scaled
    return None
