"""Keys by which variables are grouped into valves: folder, plant code, loop number, index, tag."""

import re

from valvemap.plant.candidates import Candidate
from valvemap.plant.names import concept_of, tokens
from valvemap.plant.unit_texts import split_unit

_KKS_VALVE = re.compile(r"(\d{0,2}[A-Z]{3}\d{2})(?:AA|C[PTFG])\d{3}")
_SEPARATORS = re.compile(r'"?\.(?=["A-Za-z_\u4e00-\u9fff])"?|/|\\|:')
_INDEX = re.compile(r"\[([\d,\s]+)\]")

Place = tuple[str, ...]


def folder_of(one: Candidate) -> Place:
    """Group by path: the folder, or the part of a tag before its last name."""
    name, _, _ = split_unit(one.path[-1].strip('"'))
    return (*one.path[:-1], *_SEPARATORS.split(name)[:-1])


def by_code(one: Candidate) -> Place:
    """Group by the plant and system of a KKS code."""
    match = _KKS_VALVE.search(one.path[-1].upper())
    return () if match is None else (match[1],)


def by_number(one: Candidate) -> Place:
    """Group by the number of the loop, as in PT-101."""
    return tuple(word for word in _rest(one) if word.isdigit() and len(word) > 1)


def by_index(one: Candidate) -> Place:
    """Group by the index of an array's element, as in cmd[3]."""
    return tuple(index for part in one.path for index in _INDEX.findall(part))


def by_rest(one: Candidate) -> Place:
    """Group by the words of a flat tag that do not describe the signal."""
    return tuple(_rest(one))


def _rest(one: Candidate) -> list[str]:
    words = tokens(one.label.name)
    return [word for word in words if not concept_of(word) and word not in {"a", "b"}]
