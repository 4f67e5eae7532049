"""The sets of plants that vendors and integrators might have written, in the order of their making.

Each set was drawn before the tables of names were read, once the one before had been mended.
"""

from collections.abc import Callable, Mapping
from typing import Final

from benchmarks.connect_eighth import EIGHTH
from benchmarks.connect_fifth import FIFTH
from benchmarks.connect_fourth import FOURTH
from benchmarks.connect_ninth import NINTH
from benchmarks.connect_plants import Plant
from benchmarks.connect_second import SECOND
from benchmarks.connect_seventh import SEVENTH
from benchmarks.connect_sixth import SIXTH
from benchmarks.connect_tenth import TENTH
from benchmarks.connect_unseen import UNSEEN

SETS: Final[Mapping[str, Mapping[str, Callable[[int], Plant]]]] = {
    "first two": UNSEEN | SECOND,
    "fourth": FOURTH,
    "fifth": FIFTH,
    "sixth": SIXTH,
    "seventh": SEVENTH,
    "eighth": EIGHTH,
    "ninth": NINTH,
    "tenth": TENTH,
}
"""Plants by set and name; each is made of a seed."""
