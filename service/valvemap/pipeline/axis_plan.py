"""The configuration of an axis, and the hash that its stored states are bound to. Pure."""

from dataclasses import dataclass
from functools import cached_property

from valvemap.model.axis import AxisGeometry
from valvemap.model.estimator import key_of
from valvemap.pipeline.feedforward import FeedForward
from valvemap.pipeline.meaning import Meaning


@dataclass(frozen=True)
class AxisPlan:
    """Configuration of one axis; ``meaning`` is that of its signals, None: unknown.

    ``is_frozen``: the stored map stays as it is; nothing is learnt, nothing is found.
    ``has_speed``: the piston's speed is measured, and not its position. ``is_tracked``: there is a
    set position; line B has it where line A has T. ``former_key``: what states of earlier versions
    are bound to, if they are of this configuration; empty: there are none.
    """

    name: str
    geometry: AxisGeometry
    memory_s: float = 1_800.0
    meaning: Meaning | None = None
    feed_forward: FeedForward | None = None
    is_frozen: bool = False
    has_speed: bool = False
    is_tracked: bool = False
    former_key: str = ""

    @cached_property
    def key(self) -> str:
        """The hash that a stored state is bound to: by geometry, and what measures the piston."""
        return key_of(_Bound(self.geometry, self.has_speed))


@dataclass(frozen=True)
class _Bound:
    """What a stored state is valid for, beside the meaning of its signals."""

    geometry: AxisGeometry
    has_speed: bool
