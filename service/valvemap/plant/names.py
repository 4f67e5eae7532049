"""Names of signals: words, and the concepts that the words mean."""

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from typing import Final

from valvemap.plant.concepts import COMPACT, PORT_LETTERS, QUANTITIES, Concept
from valvemap.plant.qualifier_words import QUALIFIER_WORDS
from valvemap.plant.quantity_words import QUANTITY_WORDS

_KKS = re.compile(
    r"(?<![A-Z])\d{0,2}[A-Z]{3}\d{2}(?P<device>AA|C[PTFGL])\d{3}(?:[ ._-]*(?P<signal>[XY]Q)\d{2})?"
)
_KKS_CONCEPTS: Final[Mapping[str, Concept]] = {
    "AA": Concept.VALVE,
    "CP": Concept.PRESSURE,
    "CT": Concept.TEMPERATURE,
    "CF": Concept.FLOW,
    "CG": Concept.OPENING,
    "CL": Concept.LEVEL,
}
_KKS_OF_VALVES: Final[Mapping[str, tuple[Concept, ...]]] = {
    "XQ": (Concept.SPOOL, Concept.ACTUAL),  # an analogue value that comes from the device
    "YQ": (Concept.COMMAND,),  # one that goes to it
}
_INSIDE: Final = 0.7  # certainty of a word inside a compound
_SHORTEST_INSIDE, _SHORTEST_AT_AN_END = 5, 4  # letters of a word found inside a compound
UNSPACED: Final = "\u3040-\u30ff\u4e00-\u9fff\uac00-\ud7a3"
"""Letters of Japanese, Chinese and Korean, which stand together as one word."""
_CYRILLIC: Final = "\u0400-\u04ff"
_WORD = re.compile(rf"[a-z0-9]+|[{UNSPACED}]+|[{_CYRILLIC}]+")
_WHOLE = re.compile(rf"[pqut][12]|[a-z]+|[{UNSPACED}]+|[{_CYRILLIC}]+|\d+")
_IS_UNSPACED = re.compile(f"[{UNSPACED}]")
_STROKED: Final = str.maketrans("łøđı", "lodi")  # letters that no accent is taken off
_ABBREVIATED = re.compile(r"[b-df-hj-np-tv-z]{3,5}")
_LETTER_AND_NUMBER = re.compile(r"[pqut][12]")
_OF_DESIGNATION: Final = 0.5  # certainty of what a letter and its number tell beside a word
_PIECE = re.compile(r"p[12](?!\d)|[a-z]+|\d+")


def tokens(text: str) -> list[str]:
    """Words of a name, without case and accents; ``flowRate`` and ``PT101`` are two each.

    >>> tokens('"DB10"."FCV-101"."Öldruck_Vor"'), tokens("PT101a"), tokens("pT")
    (['db', '10', 'fcv', '101', 'oldruck', 'vor'], ['pt', '101', 'a'], ['p', 't'])
    """
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[Δ∆])", " ", unicodedata.normalize("NFKC", text))
    plain = parted.replace("Δ", " delta ").replace("∆", " delta ")
    found: list[str] = []
    for word in _WORD.findall(_without_accents(plain.casefold())):
        found += [word] if _WHOLE.fullmatch(word) else _PIECE.findall(word)
    return found


def concepts(text: str) -> dict[Concept, float]:
    """Return the concepts in a name, each with the certainty of its best word, 0 to 1.

    >>> sorted(c.name for c in concepts("Druck vor Ventil"))
    ['BEFORE', 'PRESSURE', 'VALVE']
    >>> sorted(c.name for c in concepts("pA")), sorted(c.name for c in concepts("阀后压力"))
    (['PORT_A', 'PRESSURE'], ['BEHIND', 'PRESSURE', 'VALVE'])
    >>> [c.name for c in concepts("Caudal_V5")]  # V5 is the valve, and no speed
    ['FLOW']
    """
    words = tokens(text)
    found: dict[Concept, float] = {}
    meanings = list(_meanings(words))
    designations = set(_designations(words))
    parts = [
        (place, concept, certainty if place not in designations else _OF_DESIGNATION * certainty)
        for place, concept, certainty in meanings
        if place not in designations or concept not in QUANTITIES
    ]
    if not any(concept in QUANTITIES for _, concept, _ in parts):
        parts = meanings
    for _, concept, certainty in parts:
        found[concept] = max(certainty, found.get(concept, 0.0))
    code = _KKS.search(text.upper())
    if code is not None:
        found = {_KKS_CONCEPTS[code["device"]]: 1.0}
        if code["device"] == "AA":
            found |= dict.fromkeys(_KKS_OF_VALVES.get(code["signal"] or "", ()), 1.0)
    if Concept.PRESSURE in found and Concept.PILOT in found:
        found.pop(Concept.COMMAND, None)
    if Concept.PRESSURE not in found:
        found.pop(Concept.CONSUMER, None)  # a load is a weight, too
    return found


def concept_of(word: str) -> Mapping[Concept, float]:
    """Return the concepts of one word."""
    return _of_word(word)


def _designations(words: Sequence[str]) -> Iterator[int]:
    """Yield the places of letters that may designate a device, as in V5, Y1 or P2.Pressure."""
    for place, (word, following) in enumerate(pairwise((*words, ""))):
        is_numbered = len(word) == 1 and word.isalpha() and following.isdigit()
        if is_numbered or _LETTER_AND_NUMBER.fullmatch(word):
            yield place


def _meanings(words: Sequence[str]) -> Iterator[tuple[int, Concept, float]]:
    """Yield place, concept and certainty of each word."""
    ports = set[int]()
    for place, (word, following) in enumerate(pairwise(words)):
        quantities = {Concept.PRESSURE, Concept.FLOW} & set(_of_word(word))
        if following in PORT_LETTERS and quantities:
            yield from ((place, concept, 1.0) for concept in PORT_LETTERS[following])
            ports.add(place + 1)
    for place, word in enumerate(words):
        if place in ports:
            continue
        if word in {"a", "b"}:
            alone = Concept.PORT_A if word == "a" else Concept.PORT_B
            yield place, alone, 0.5
            continue
        yield from ((place, concept, certainty) for concept, certainty in _of_word(word).items())


def _without_accents(text: str) -> str:
    """Return a text without the marks of its letters; syllables of Korean stay whole."""
    parts = unicodedata.normalize("NFKD", text.replace("ß", "ss").translate(_STROKED))
    kept = "".join(letter for letter in parts if not unicodedata.combining(letter))
    return unicodedata.normalize("NFC", kept)


@cache
def _of_word(word: str) -> Mapping[Concept, float]:
    if word in COMPACT:
        return dict.fromkeys(COMPACT[word], 1.0)
    exact = {concept: 1.0 for concept, known in _KNOWN.items() if word in known}
    if exact:
        return exact
    if _ABBREVIATED.fullmatch(word):
        return _of_abbreviation(word)
    found = {
        concept: max(_certainty(word, k) for k in known)
        for concept, known in _KNOWN.items()
        if any(_holds(word, k) for k in known)
    }
    longest = {
        concept: max(len(k) for k in _KNOWN[concept] if _holds(word, k))
        for concept in found
        if concept in QUANTITIES
    }
    if len(longest) > 1:  # a compound ends in its head
        head = max(longest, key=lambda concept: (_ends(word, concept), longest[concept]))
        found = {c: w for c, w in found.items() if c not in QUANTITIES or c is head}
    return found


def _of_abbreviation(word: str) -> Mapping[Concept, float]:
    """Return the concept of an English word that was written without its vowels, if it is one.

    >>> [[c.name for c in _of_abbreviation(w)] for w in ("dmd", "prs", "flw", "plc")]
    [['COMMAND'], ['PRESSURE'], ['FLOW'], []]
    """
    found = [
        concept for concept, known in _ENGLISH.items() if any(_shortens(word, k) for k in known)
    ]
    return dict.fromkeys(found, 0.7) if len(found) == 1 else {}


def _shortens(word: str, skeleton: str) -> bool:
    """Whether a word has the first two consonants of a word, and others of it in order."""
    letters = iter(skeleton)
    return word[:2] == skeleton[:2] and all(letter in letters for letter in word)


def _skeleton(word: str) -> str:
    """Return a word without vowels behind its first letter, doubled consonants once."""
    plain = word[:1] + re.sub(r"[aeiou]", "", word[1:])
    return re.sub(r"(.)\1+", r"\1", plain)


def _certainty(word: str, known: str) -> float:
    """Return the certainty of a word inside another one; Chinese and Japanese part no words."""
    if not _holds(word, known):
        return 0.0
    return 1.0 if _IS_UNSPACED.match(known) and len(known) > 1 else _INSIDE


def _ends(word: str, concept: Concept) -> bool:
    return any(word.endswith(known) for known in _KNOWN[concept] if _holds(word, known))


def _holds(word: str, known: str) -> bool:
    if _IS_UNSPACED.match(known) is not None:
        return known in word
    inside = len(known) >= _SHORTEST_INSIDE and known in word
    at_an_end = len(known) >= _SHORTEST_AT_AN_END and word.startswith(known)
    at_an_end = at_an_end or (len(known) >= _SHORTEST_AT_AN_END and word.endswith(known))
    return inside or at_an_end


_WORDS: Final = {**QUANTITY_WORDS, **QUALIFIER_WORDS}
_KNOWN: Final = {
    concept: frozenset(_without_accents(" ".join(languages.values())).split())
    for concept, languages in _WORDS.items()
}
_ENGLISH: Final = {
    concept: [_skeleton(word) for word in languages.get("en", "").split()]
    for concept, languages in _WORDS.items()
}
