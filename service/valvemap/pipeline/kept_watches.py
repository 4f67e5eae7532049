"""The watch of an axis as bytes: its reference and condition. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from valvemap.model.axis import AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_condition import Condition, Reference
from valvemap.model.axis_fit import with_theta
from valvemap.model.axis_force import SUMS as FORCE_SUMS
from valvemap.model.axis_force import ForceReference, ForceState
from valvemap.model.contents import Contents
from valvemap.pipeline.axis_watch import SUMS, AxisWatch, AxisWindowSums
from valvemap.pipeline.kept_axes import NEWER, KeptShape, shape_of, with_newer_columns

_OF_CONDITION: Final = ("probability", "size", "std", "mean", "spread")


@dataclass(frozen=True)
class _KeptWatch(KeptShape):
    """The stored form of a watch; windows that have not joined the reference are not.

    Without a balance of forces, ``force_transition`` is 0.
    """

    state_version: ClassVar[int] = 4  # 3: no columns of the delays; 2: nor of the force

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Add the columns of the force and of the delays, of which nothing is known."""
        found = with_newer_columns(arrays) if version in ("2", "3") else {}
        if found:
            added = np.arange(np.size(arrays["theta"]), SIZE)
            found["precision"][added, added] = np.array(NEWER)[added - SIZE] ** -2.0
        return found

    theta: Any
    precision: Any
    variance: Any
    together: Any
    M: Any
    b: Any
    squares: Any
    errors: Any
    scores: Any
    probability: Any
    size: Any
    std: Any
    mean: Any
    spread: Any
    force_transition: Any
    force_sigma: Any
    force_together: Any
    force_theta: Any
    force_precision: Any
    force_M: Any
    force_b: Any
    force_squares: Any
    force_scores: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            **super().contents(),
            "variance": Contents(self.variance).within(0.0),
            "together": Contents(self.together).within(1.0),
            "squares": Contents(self.squares).within(0.0),
            "probability": Contents(self.probability).within(0.0, 1.0),
            "force_transition": Contents(self.force_transition).within(0.0, 1.0),
            "force_sigma": Contents(self.force_sigma).within(0.0),
            "force_together": Contents(self.force_together).within(1.0),
            "force_squares": Contents(self.force_squares).within(0.0),
            "size": Contents(self.size).or_nan(),
            "std": Contents(self.std).or_nan(),
        }


def pack_watch(watch: AxisWatch, key: str) -> bytes:
    """Return the watch as bytes, bound to ``key``."""
    reference, condition = watch.reference, watch.condition
    return _KeptWatch(
        **shape_of(watch.regression),
        of_shape=watch.of_shape,
        theta=reference.theta,
        precision=reference.precision,
        variance=np.array(reference.variance),
        together=np.array(reference.together),
        **{name: getattr(watch.sums.flow, name) for name in SUMS},
        **{name: getattr(condition, name) for name in _OF_CONDITION},
        **_force_numbers(reference.force, watch.sums.force),
    ).to_bytes(key)


def unpack_watch(packed: bytes, key: str, regression: AxisRegression) -> AxisWatch:
    """Return the watch that `pack_watch` has packed; ``regression`` has geometry and memory.

    Raises
    ------
    StateMismatchError
        if it is damaged, or bound to something else.
    """
    kept = _KeptWatch.from_bytes(packed, key)
    initial, zero, square = regression.initial_state(), np.array(0.0), np.zeros((SIZE, SIZE))
    fresh = Condition.initial()
    like: dict[str, Any] = dict.fromkeys(
        ("period_s", "play_percent", "lag_s", "variance", "together"), zero
    )
    like |= {"of_shape": square, "precision": square, "theta": np.zeros(SIZE)}
    like |= {name: getattr(initial, name) for name in SUMS}
    like |= {name: getattr(fresh, name) for name in _OF_CONDITION}
    like |= _force_numbers(None, ForceState.initial())
    kept.check(_KeptWatch(**like))
    force, sums = _force_of(kept, regression)
    flow = replace(initial, **{name: getattr(kept, name) for name in SUMS})
    return AxisWatch(
        replace(kept.of(regression), memory_s=np.inf),
        regression.memory_s,
        kept.of_shape,
        Reference(kept.theta, kept.precision, float(kept.variance), float(kept.together), force),
        AxisWindowSums(flow, sums),
        AxisWindowSums(with_theta(initial, kept.theta), ForceState.initial()),
        Condition(**{name: getattr(kept, name) for name in _OF_CONDITION}),
    )


def _force_numbers(force: ForceReference | None, sums: ForceState) -> dict[str, Any]:
    known = force or ForceReference.nothing()
    return {
        "force_transition": np.array(known.transition),
        "force_sigma": np.array(known.sigma),
        "force_together": np.array(known.together),
        "force_theta": known.theta,
        "force_precision": known.precision,
        **{f"force_{name}": getattr(sums, name) for name in FORCE_SUMS},
    }


def _force_of(
    kept: _KeptWatch, regression: AxisRegression
) -> tuple[ForceReference | None, ForceState]:
    sums = {name: getattr(kept, f"force_{name}") for name in FORCE_SUMS}
    if not kept.force_transition > 0.0:
        return None, ForceState.initial()
    found = ForceReference(
        regression.geometry,
        float(kept.period_s),
        float(kept.force_transition),
        kept.force_theta,
        kept.force_precision,
        float(kept.force_sigma),
        float(kept.force_together),
    )
    return found, replace(ForceState.initial(), **sums)
