"""What fakes of a server answer with; they fulfil `valvemap.readings`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Read:
    value: object
    code: int = 0
    t: int = 0


@dataclass(frozen=True)
class Node:
    id: str
    is_variable: bool = False
    is_method: bool = False
