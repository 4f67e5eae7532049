"""The tracking errors of all axes side by side, read when a browser asks."""

from collections.abc import Sequence
from typing import Any, Final

from valvemap.page.layout import Part, PartKind
from valvemap.page.ports import Client
from valvemap.page.reading import read_all

MOST_AXES: Final = 8  # of a chart; more could not be distinguished
_NAMES: Final = ("Rms", "Time", "Position", "SetPosition")
_BAD: Final = 0x8000_0000


async def tracking_of(client: Client, parts: Sequence[Part]) -> dict[str, Any]:
    """Return the newest seconds of each axis that has a set position.

    Raises
    ------
    SourceLost, SourceRejected
    """
    axes = [part.name for part in parts if part.kind is PartKind.AXIS][:MOST_AXES]
    ids = [f"{axis}.Tracking.{name}" for axis in axes for name in _NAMES]
    readings = iter(await read_all(client, ids))
    found = []
    for axis in axes:
        rms, t, x, x_set = (next(readings) for _ in _NAMES)
        if rms.code < _BAD and rms.value is not None:
            columns = {"t": t.value, "x": x.value, "set": x_set.value}
            shown = {name: list(map(float, value or ())) for name, value in columns.items()}
            found.append({"name": axis, "rms": float(rms.value), **shown})
    return {"tracking": found}
