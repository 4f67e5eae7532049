"""Names of valves, estimators and sources."""

from typing import Annotated, Final

from pydantic import Field

from valvemap.vocabulary.edges import PARTS

RESERVED_VALVES = ("Identification", "Service")  # names of other nodes
RESERVED_ESTIMATORS = (
    "Signals",
    "Alarms",
    "Baseline",
    "Diagnostics",
    "Dynamics",
    "Commission",
    "Inverse",
    "Frame",
    "FrameNames",
    "Identification",
    "DeviceHealth",
    "NodeVersion",
    "Recommended",
    "RecommendedReason",
    "Edge",
    "Meter",
    "ProcessValues",
    *PARTS,
)
NAME: Final = r"^[A-Za-z][A-Za-z0-9_-]{0,63}$"
ALLOWED_NAME: Final = "allowed is a letter, then letters, digits, _ or -, 64 at most"
Name = Annotated[str, Field(pattern=NAME)]


def check_unique(what: str, names: list[str]) -> None:
    """Raise ValueError if a name is there twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{what} name {twice[0]!r} is taken twice")


def check_not_reserved(what: str, names: list[str], reserved: tuple[str, ...]) -> None:
    """Raise ValueError if a name is reserved."""
    for name in names:
        if name in reserved:
            raise ValueError(f"{what} name {name!r} is taken: reserved are {', '.join(reserved)}")
