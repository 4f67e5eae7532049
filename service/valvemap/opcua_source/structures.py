"""Structures of a server's data types: their fields, and the paths to members. Pure."""

import re
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from valvemap.foreign_text import printable
from valvemap.opcua_source.wire import EXTENSION_OBJECT, FIXED_SIZES, NUMERIC_FORMATS

DEEPEST: Final = 16  # structures inside each other
MOST_FIELDS: Final = 2_000  # of a structure

Path = tuple[str | int, ...]

_NAME: Final = r"[^.;\[\]]+"
PATH: Final = rf"(?:{_NAME}|\[\d{{1,6}}\])(?:\.{_NAME}|\[\d{{1,6}}\])*"
"""The pattern of a path."""
_STEP: Final = re.compile(rf"\[(\d+)\]|({_NAME})")
_NAMED: Final = 20  # members in a message
_UNFIT: Final = re.compile(r"[.;\[\]\x00-\x1f]")


class Form(Enum):
    """How the fields of a structure are encoded: all; those of a mask; one."""

    PLAIN = 0
    OPTIONAL = 1
    UNION = 2


@dataclass(frozen=True)
class Field:
    """A field: the built-in type of its values, or their structure; ``rank`` 0: one value.

    ``optional`` fields have a bit in the mask.
    """

    name: str
    kind: int
    rank: int = 0
    structure: "Structure | None" = None
    optional: bool = False

    @property
    def size(self) -> int | None:
        """Bytes of one value; None: it says itself."""
        if self.structure is not None:
            return self.structure.size
        return FIXED_SIZES.get(self.kind)


@dataclass(frozen=True, eq=False)
class Structure:
    """The fields of a structure in order; ``size`` in bytes, None if values differ in size."""

    name: str
    fields: tuple[Field, ...]
    form: Form = Form.PLAIN
    size: int | None = field(init=False)
    depth: int = field(init=False)

    def __post_init__(self) -> None:
        """Sum up the fields' sizes."""
        sizes = [None if one.rank else one.size for one in self.fields]
        known = [size for size in sizes if size is not None]
        is_fixed = self.form is Form.PLAIN and len(known) == len(sizes)
        object.__setattr__(self, "size", sum(known) if is_fixed else None)
        inner = (one.structure.depth for one in self.fields if one.structure is not None)
        object.__setattr__(self, "depth", 1 + max(inner, default=0))


def parse_path(text: str) -> Path:
    """Return the steps of a path.

    >>> parse_path("Inlet.Pressure[2].Value")
    ('Inlet', 'Pressure', 2, 'Value')
    """
    return tuple(int(index) if index else name for index, name in _STEP.findall(text))


def path_text(path: Path) -> str:
    """Return the text of a path.

    >>> path_text(("Inlet", "Pressure", 2, "Value"))
    'Inlet.Pressure[2].Value'
    """
    steps = (f"[{one}]" if isinstance(one, int) else f".{one}" for one in path)
    return "".join(steps).removeprefix(".")


def has_a_text(path: Path) -> bool:
    """Whether each name of a path can be written in one."""
    return not any(isinstance(one, str) and (not one or _UNFIT.search(one)) for one in path)


def kind_of(structure: Structure, path: Path) -> int | str:
    """Return the built-in type of a member, or why there is none, as the end of a sentence."""
    own = Field("", EXTENSION_OBJECT, int(isinstance(path[0], int)), structure)
    for depth, step in enumerate(path):
        shown = path_text(path[:depth])
        found = _element_of(own, step, shown) if isinstance(step, int) else _in(own, step, shown)
        if isinstance(found, str):
            return found
        own = found
    shown = path_text(path)
    if own.structure is not None and not own.rank:
        return f"has a structure at '{shown}'; its members are {_names(own.structure)}"
    if own.rank or own.kind not in NUMERIC_FORMATS:
        return _needs_index(shown) if own.rank else f"has no number at '{shown}'"
    return own.kind


def _element_of(own: Field, index: int, shown: str) -> Field | str:
    if own.rank > 1:
        return f"has an array of several dimensions at '{shown}'"
    if not own.rank:
        return f"has no array at '{shown}'; leave out [{index}]"
    return Field(own.name, own.kind, 0, own.structure)


def _in(own: Field, name: str, shown: str) -> Field | str:
    if own.rank:
        return _needs_index(shown)
    if own.structure is None:
        return f"has no structure at '{shown}' whose members are known"
    found = next((one for one in own.structure.fields if one.name == name), None)
    there = _names(own.structure)
    return found or f"has no member '{shown}.{name}'; there are {there}".replace("'.", "'", 1)


def _needs_index(shown: str) -> str:
    return f"has an array at '{shown}'; it needs an index such as [0]"


def _names(structure: Structure) -> str:
    names = [printable(one.name) for one in structure.fields]
    return ", ".join(names[:_NAMED]) + (", …" if len(names) > _NAMED else "")
