"""Names of valves from their places among a plant's variables."""

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from typing import Final

_LONGEST_NAME: Final = 56


def short_names(places: Sequence[tuple[str, ...]]) -> dict[tuple[str, ...], str]:
    """Return a unique name for each path: its last part, with as many before it as necessary."""
    depths = range(1, max(1, *map(len, places)) + 1)
    at_depth = [[_name("_".join(place[-depth:])) for place in places] for depth in depths]
    for names in at_depth:
        if len(set(names)) == len(names):
            return dict(zip(places, names, strict=True))
    counts = [Counter(names) for names in at_depth]
    found: dict[tuple[str, ...], str] = {}
    taken: set[str] = set()
    for number, place in enumerate(places):
        own = (
            names[number]
            for names, n in zip(at_depth, counts, strict=True)
            if n[names[number]] == 1
        )
        name = next((name for name in own if name not in taken), f"Valve{number + 1}")
        found[place] = name
        taken.add(name)
    return found


def _name(text: str) -> str:
    plain = unicodedata.normalize("NFKD", text)
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", plain).strip("_")[:_LONGEST_NAME]
    return name if name[:1].isalpha() else f"V{name}" if name else "Valve"
