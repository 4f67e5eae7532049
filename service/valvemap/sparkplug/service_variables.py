"""Finds what the service shows of each valve, and what a client may command, by browsing it."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Final, NamedTuple

from valvemap.readings import Child
from valvemap.sparkplug.metrics import Meaning
from valvemap.sparkplug.ports import Service
from valvemap.sparkplug.schema import DataType
from valvemap.sparkplug.shown import Variable
from valvemap.vocabulary.commands import NAMED, Action, Subject
from valvemap.vocabulary.edges import split_id

_ROOT: Final = "Identification"
_OF_SERVICE: Final = "Service"
_COPIES: Final = ("Condition", "ProcessValues")  # other nodes of variables, created when browsed
_VERSIONS: Final = ".NodeVersion"  # versions of the address space, not results
NODE_VERSION: Final = f"{_ROOT}{_VERSIONS}"
"""Changes when valves are added or removed."""
_ALARMS: Final = "Alarms"
_MEANING: Final = "Meaning"
_MEANING_OF: Final = "What the alarm means, and what to do."
_KINDS: Final = {
    "Boolean": DataType.BOOLEAN,
    "SByte": DataType.INT8,
    "Byte": DataType.UINT8,
    "Int16": DataType.INT16,
    "UInt16": DataType.UINT16,
    "Int32": DataType.INT32,
    "UInt32": DataType.UINT32,
    "Int64": DataType.INT64,
    "UInt64": DataType.UINT64,
    "Float": DataType.FLOAT,
    "Double": DataType.DOUBLE,
    "String": DataType.STRING,
    "LocalizedText": DataType.STRING,
    "DateTime": DataType.DATE_TIME,
}


class _Found(NamedTuple):
    """A node below the service's root: its device (None: the service) and its dotted name there."""

    id: str
    device: str | None
    dotted: str

    @property
    def metric(self) -> str:
        return self.dotted.replace(".", "/")


async def find_variables(
    service: Service, wanted: Sequence[str], allowed: Collection[str]
) -> list[Variable]:
    """Return the variables that become metrics, and metrics without a variable.

    Parameters
    ----------
    service
        The service, connected.
    wanted
        Patterns of names, of which one must match; an allowed command is always a metric.
    allowed
        Names of the commands that MQTT clients may give. Their variables have an ``action``; of a
        command that is a method with a text, a metric of the method's name is added.

    Notes
    -----
    Scalars of supported types are returned. To each alarm comes a text with its meaning, which is
    the description of the alarm's node.
    """
    commands = [NAMED[name] for name in allowed]
    variables, alarms, methods = await _browse(service, wanted, commands)
    types = await service.scalar_types([one.id for one in variables])
    scalars = [
        (one, _KINDS[type_]) for one, type_ in zip(variables, types, strict=True) if type_ in _KINDS
    ]
    said = await service.engineering([one.id for one, _ in scalars] + [one.id for one in alarms])
    found = [
        Variable(
            one.id,
            one.device,
            one.metric,
            kind,
            Meaning(of.unit, of.range, of.description),
            _written(commands, one) if kind is DataType.DOUBLE else None,
        )
        for (one, kind), of in zip(scalars, said[: len(scalars)], strict=True)
    ]
    meanings = [
        Variable(
            f"{one.id}.{_MEANING}",
            one.device,
            f"{one.metric}/{_MEANING}",
            DataType.STRING,
            Meaning(description=_MEANING_OF),
            text=of.description,
        )
        for one, of in zip(alarms, said[len(scalars) :], strict=True)
        if _matches(f"{one.dotted}.{_MEANING}", wanted)
    ]
    return [*found, *meanings, *_called(commands, methods)]


async def _browse(
    service: Service, wanted: Sequence[str], commands: Sequence[Action]
) -> tuple[list[_Found], list[_Found], list[_Found]]:
    """Return the wanted variables, the objects of alarms, and the methods."""
    variables: list[_Found] = []
    alarms: list[_Found] = []
    methods: list[_Found] = []
    level: list[str | None] = [_ROOT]
    while level:
        children = [child for some in await service.browse_each(level) for child in some]
        level = []
        for child in children:
            one = _found(child)
            if child.id.endswith(_VERSIONS):
                continue
            if child.is_variable:
                if _matches(one.dotted, wanted) or _written(commands, one):
                    variables.append(one)
            elif child.is_method:
                methods.append(one)
            elif child.id.rpartition(".")[2] not in _COPIES:
                level.append(child.id)
                if _parent(child.id) == _ALARMS:
                    alarms.append(one)
    return variables, alarms, methods


def _found(child: Child) -> _Found:
    device, name = split_id(child.id)
    return (
        _Found(child.id, None, child.id)
        if device == _OF_SERVICE
        else _Found(child.id, device, name)
    )


def _written(commands: Iterable[Action], one: _Found) -> Action | None:
    """Return the command that is given by writing a variable of a device."""
    last = one.id.rpartition(".")[2]
    actions = (action for action in commands if last in action.variables)
    return next(actions, None) if one.device is not None else None


def _called(commands: Iterable[Action], methods: Iterable[_Found]) -> Iterator[Variable]:
    """Yield a metric for each method of a device's alarms that is an allowed command."""
    by_method = {action.method: action for action in commands if action.on is Subject.ALARM}
    for one in methods:
        owner, _, last = one.id.rpartition(".")
        if one.device is not None and last in by_method and _parent(owner) == _ALARMS:
            action = by_method[last]
            words = Meaning(description=f"{action.sentence} Write a comment.")
            yield Variable(one.id, one.device, one.metric, DataType.STRING, words, action, text="")


def _parent(id_: str) -> str:
    """Return the last name of a node's parent.

    >>> _parent("V1.Alarms.Changed")
    'Alarms'
    """
    return id_.rpartition(".")[0].rpartition(".")[2]


def _matches(dotted: str, wanted: Sequence[str]) -> bool:
    return any(fnmatchcase(dotted, pattern) for pattern in wanted)
