"""The dynamics of a valve in cells and sentences."""

from collections.abc import Iterator
from typing import Final

from valvemap.model.dynamics import Dynamics, Quantity
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES
from valvemap.vocabulary.statuses import Status

HEADINGS: Final = ("quantity", "value", "95 % interval", "unit", "meaning")


def rows_of(found: Dynamics) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each quantity, under the headings."""
    for quantity in DYNAMIC_QUANTITIES:
        one: Quantity = getattr(found, quantity.field)
        texts, (unit, factor) = ("-", Status.UNEXCITED.label), quantity.in_words
        if one.status is Status.OK:
            low, high = (factor * end for end in one.interval)
            texts = f"{factor * one.value:.4g}", f"{low:.4g} … {high:.4g}"
        yield quantity.name, *texts, unit, quantity.sentence


def notes_of(found: Dynamics) -> Iterator[str]:
    """Yield what belongs to the figures."""
    between = f"U between two samples: {found.hold.value}."
    yield f"Step of T90: {found.step_percent:.3g} % of U. {between}"
    if found.play_percent > 0.0:
        yield f"The spool has a play of {found.play_percent:.2g} % of U, or it sticks by so much."
    yield (
        f"The residual is {found.noise:.3g} l/min. If that is more than the flow meter's noise, "
        "the model misses something, and the figures with it."
    )
