"""One valve's alarms and the statistics that judge them, as bytes of a checkpoint. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.alarm_rules import ALARM_NAMES
from valvemap.pipeline.alarm_statistics import LOSSES
from valvemap.pipeline.kernels import alarm_layout as layout
from valvemap.pipeline.quantity_alarms import KeptAlarms, check_layout

_KEY = f"alarms 2: {' '.join(ALARM_NAMES)}"


def pack(row: Mapping[str, NDArray[Any]], reason: str, remarks: NDArray[np.uint8]) -> bytes:
    """Pack the alarms of one valve, without the losses of the last minute.

    Parameters
    ----------
    row
        The valve's row of each array of its alarms and their statistics.
    reason
        Why a lane of the valve has stopped; empty if none has.
    remarks
        The operators' comments, packed.
    """
    memory, times = row["memory"].copy(), row["times"].copy()
    memory[LOSSES], times[layout.LOSS_TIME] = 0.0, layout.NEVER
    kept = {**row, "memory": memory, "times": times, "reason": np.array(reason)}
    return _Kept(**kept, remarks=remarks).to_bytes(_KEY)


def unpack(
    data: bytes, arrays: Mapping[str, NDArray[Any]]
) -> tuple[dict[str, NDArray[Any]], str, NDArray[np.uint8]]:
    """Return what `pack` packed; ``arrays`` are those of the present layout, each (M, …).

    Raises
    ------
    StateMismatchError
        if the bytes are damaged, or their layout differs from the present one.
    """
    kept = _Kept.from_bytes(data, _KEY)
    check_layout(kept, arrays)
    return {name: getattr(kept, name) for name in arrays}, str(kept.reason), kept.remarks


@dataclass(frozen=True)
class _Kept(KeptAlarms):
    """The arrays of one valve; states in files bear the name of this class."""

    last: Any
    still: Any
    longest: Any
    moves: Any
    others: Any
    weight: Any
    bias: Any
    square: Any
    sums: Any
    memory: Any
    times: Any
    reason: Any
