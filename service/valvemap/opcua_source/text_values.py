"""Variables that send their numbers as texts, such as ``12,3 bar``: found, and asked for."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from asyncua import ua

from valvemap.plant.candidates import Candidate
from valvemap.plant.unit_texts import known_unit

_NUMBER_IN_TEXT: Final = re.compile(r"([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?")
_LONGEST_NUMBER: Final = 40  # characters of a text that may be a number

Answer = Sequence[ua.DataValue]


def has_number(answer: Answer) -> bool:
    """Whether a node's value is a text that holds a number, and its unit at most."""
    return number_in(_text_of(answer)) is not None


def _text_of(answer: Answer) -> str:
    """Return the text of a scalar String, else an empty one."""
    value = answer[0].Value
    is_text = value is not None and value.VariantType == ua.VariantType.String
    return str(value.Value or "") if is_text and isinstance(value.Value, str) else ""


def number_in(text: str) -> tuple[str, str] | None:
    """Return number and unit of a text that holds nothing else; None of others.

    >>> number_in("12,3 bar"), number_in(" -4.5"), number_in("V1.2.3"), number_in("12:30")
    (('12,3', 'bar'), ('-4.5', ''), None, None)
    """
    found = _NUMBER_IN_TEXT.fullmatch(text[:_LONGEST_NUMBER].strip())
    if found is None or (found[2] and known_unit(found[2]) is None):
        return None
    return found[1], found[2] or ""


def as_text(candidate: Candidate, answer: Answer) -> Iterator[Candidate]:
    """Yield a variable that sends its number as a text, if it looks like a signal of a valve."""
    text = _text_of(answer)
    _, unit = number_in(text) or ("", "")
    own = replace(
        candidate, text=text.strip(), unit=candidate.unit or known_unit(unit), largest=None
    )
    if own.label.is_relevant:
        yield own
