"""Flow meters behind several valves: one node of Q that several valves name."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from valvemap.model.shared_meter import MOST_VALVES

if TYPE_CHECKING:
    from valvemap.config.valves import ValveConfig


def meters_of(valves: "Sequence[ValveConfig]") -> Mapping[str, str]:
    """Return the shared meter of each valve that has one, by the valve's name.

    Valves that name the same nodes of U and Q are one valve configured twice, and share nothing.
    """
    behind: dict[str, list[ValveConfig]] = {}
    for valve in valves:
        behind.setdefault(f"{valve.source or ''} {valve.nodes.Q}", []).append(valve)
    found = {}
    for meter, own in behind.items():
        if len({valve.nodes.U for valve in own}) > 1:
            found.update({valve.name: meter for valve in own})
    return found


def check_meters(valves: "Sequence[ValveConfig]") -> None:
    """Refuse a shared meter that cannot be divided.

    Raises
    ------
    ValueError
        naming the valves.
    """
    found = meters_of(valves)
    for meter in dict.fromkeys(found.values()):
        own = [valve for valve in valves if found.get(valve.name) == meter]
        names = ", ".join(valve.name for valve in own)
        what = f"valves {names} name one node of Q, {own[0].nodes.Q}"
        if len({valve.nodes.U for valve in own}) < len(own) and "." not in own[0].name:
            raise ValueError(f"{what}, and some of them one node of U: each valve once")
        if len(own) > MOST_VALVES:
            raise ValueError(f"{what}: at most {MOST_VALVES} valves may be behind one meter")
        if any("." in valve.name for valve in own):
            raise ValueError(
                f"{what}: edges of valves with ports need a meter in each line; give each valve "
                "[valves.nodes] with the pressures of one edge, or a meter"
            )
        if any(valve.signals.Q != own[0].signals.Q for valve in own):
            raise ValueError(f"{what}: signals.Q must be the same in each of them")
