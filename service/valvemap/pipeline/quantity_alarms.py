"""Alarms of one owner that are driven by a quantity each: of the service, and of an axis. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import State, StateMismatchError
from valvemap.model.samples import Floats
from valvemap.pipeline.alarm_results import AlarmReport, Remark
from valvemap.pipeline.alarm_states import AlarmRule, AlarmStates
from valvemap.pipeline.kernels.alarm_steps import move_on
from valvemap.vocabulary.statuses import Described

Kind = TypeVar("Kind", bound=Described)


@dataclass(frozen=True)
class KeptAlarms(State):
    """Alarms as stored in a checkpoint."""

    state_version: ClassVar[int] = 3  # 2: the end of an alarm was not stored

    over: Any
    since: Any
    at: Any
    active: Any
    acked: Any
    value: Any
    detail: Any
    causes: Any
    came: Any
    version: Any
    confirmed: Any
    ended: Any
    remarks: Any

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Add the ends of alarms: an acknowledged one ended at its last action at the latest."""
        if version != "2":
            return {}
        return arrays | {"ended": np.zeros_like(arrays["came"])}


class QuantityAlarms(Generic[Kind]):
    """Alarms whose labels are their names; their state is updated in place.

    Parameters
    ----------
    rules
        The alarms that the owner has, with the rule of each.
    falls
        Those that are active below their limit: their quantity is given negated.
    """

    def __init__(self, rules: Mapping[Kind, AlarmRule], falls: Sequence[Kind] = ()) -> None:
        self._numbers = {alarm: number for number, alarm in enumerate(rules)}
        self._names = [alarm.label for alarm in rules]
        self._limits = limits_of([*rules.values()])
        for alarm in falls:
            limit = self._limits[self._numbers[alarm]]
            hysteresis = limit[0] - limit[1]
            limit[0], limit[1] = -limit[0], -limit[0] - hysteresis
        self._states = AlarmStates(1, self._names, [*rules.values()])
        self._conditions = self._states.conditions
        self._reasons = [""] * len(rules)
        self._key = f"alarms 2: {' '.join(self._names)}"

    @property
    def version(self) -> int:
        """Number of changes."""
        return int(self._conditions.version[0])

    def note(self, now: int, values: Mapping[Kind, float]) -> None:
        """Update with the quantity of each alarm; NaN is unknown and changes nothing."""
        t, one, value, came = np.array([now]), np.zeros(1, np.int64), np.empty(1), np.empty(1, bool)
        for alarm, x in values.items():
            if math.isnan(x):
                continue
            value[0] = x
            move_on(one, t, t, value, self._numbers[alarm], self._limits, self._conditions, came)

    def give_reason(self, alarm: Kind, reason: str) -> None:
        """Set the reason that the text of an alarm names."""
        self._reasons[self._numbers[alarm]] = reason

    def acknowledge(self, name: str, remark: Remark) -> bool:
        """Acknowledge an alarm, by its name; False if there was nothing to acknowledge."""
        return self._states.acknowledge(0, self._names.index(name), remark)

    def confirm(self, name: str, remark: Remark) -> bool:
        """Confirm an alarm; False if there was nothing to confirm."""
        return self._states.confirm(0, self._names.index(name), remark)

    def remark(self, name: str, remark: Remark) -> None:
        """Store an operator's comment on an alarm."""
        self._states.remark(0, self._names.index(name), remark)

    def reports(self) -> tuple[AlarmReport, ...]:
        """Return the state of every alarm, in words."""
        return self._states.reports(0, self._reasons)

    def to_bytes(self, key: str = "") -> bytes:
        """Pack the alarms, bound to ``key``."""
        kept = {name: array[0] for name, array in self._states.arrays().items()}
        remarks = self._states.remarks_to_bytes(0)
        return KeptAlarms(**kept, remarks=remarks).to_bytes(self._key + key)

    def from_bytes(self, data: bytes, key: str = "") -> None:
        """Unpack the alarms that were bound to ``key``.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, or of other alarms.
        """
        kept = KeptAlarms.from_bytes(data, self._key + key)
        check_layout(kept, self._states.arrays())
        self._states.remarks_from_bytes(0, kept.remarks)
        for name, array in self._states.arrays().items():
            array[0] = getattr(kept, name)


def check_layout(kept: State, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Raise if a stored array has another shape or type than a row of the present one."""
    for name, array in arrays.items():
        new = getattr(kept, name)
        if new.shape != array[0].shape or new.dtype != array.dtype:
            raise StateMismatchError(f"alarms are kept in another way today: {name}")


def limits_of(rules: Sequence[AlarmRule]) -> Floats:
    """Return limit, release (both in the quantity's unit) and delay (ns) of each rule, (A, 3)."""
    return np.array([(r.limit, r.limit - r.hysteresis, 1e9 * r.delay_s) for r in rules])
