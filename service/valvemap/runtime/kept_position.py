"""The source's position among the stored states: kept with them, resumed at the start."""

from collections.abc import Sequence
from typing import Any, Final

from valvemap.clock import Clock
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import Checkpoint

POSITION: Final = "Service", "Position"  # key of the source's position; no valve has this name
LOST_PLACE: Final = "not a position at this source: samples may be missing"


def position_of(source: AllSources, mark: Any, clock: Clock) -> list[Checkpoint]:  # noqa: ANN401
    """Return the position of a mark as a checkpoint; none without a mark."""
    if mark is None:
        return []
    state = source.position(mark)
    return [Checkpoint(*POSITION, "", clock.now(), state, lam=None, frozen=False)]


def resume_source(
    source: AllSources, stored: Sequence[Checkpoint]
) -> tuple[list[Checkpoint], dict[str, str]]:
    """Resume at the stored position, and make the source keep its messages until a commit.

    Returns the other checkpoints, and the reason why a position is refused, by its name.
    """
    others, refused = [], {}
    for one in stored:
        if (one.valve, one.estimator) != POSITION:
            others.append(one)
        elif not source.resume_at(one.state):
            refused[".".join(POSITION)] = LOST_PLACE
    source.hold_back()
    return others, refused
