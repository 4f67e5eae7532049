"""Lines and axes in view: their variables as the service describes them, read once a second.

An axis has no estimators, and a line one without a map. Both have few variables, so that all are
shown, with the units and descriptions of their nodes.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from valvemap.page.judgement import AXIS_SEVERITIES, INVERSE_SEVERITIES, Severity
from valvemap.page.layout import Part, PartKind
from valvemap.page.ports import Client
from valvemap.page.store import Store
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.health import DeviceHealth
from valvemap.vocabulary.statuses import AxisStatus, Described, InverseStatus, LineEdge

_OBJECTS: Final[Mapping[PartKind, frozenset[str]]] = {
    PartKind.LINE: frozenset({"Signals", "Inverse"}),
    PartKind.AXIS: frozenset({*EDGES, "Inverse"}),
}
_LEFT_OUT: Final = frozenset({"Frame", "FrameNames", "Map", "MapQ", "MapDp"})
_CODES: Final[Mapping[PartKind, Mapping[str, type[Described]]]] = {
    PartKind.LINE: {
        "DeviceHealth": DeviceHealth,
        "Inverse.Edge": LineEdge,
        "Inverse.RequiredUStatus": InverseStatus,
    },
    PartKind.AXIS: {
        "DeviceHealth": DeviceHealth,
        "Status": AxisStatus,
        "Inverse.RequiredUStatus": InverseStatus,
    },
}
_OF_SPEED: Final = (
    ("flow", "speed"),
    ("a larger pressure drop", "more pressure"),
    ("this pressure drop", "these pressures"),
    ("the pressure drop", "a pressure"),
    ("pressure drop", "pressures"),
)
_NAMES, _UNITS, _SENTENCES = "Described.Names", "Described.Units", "Described.Sentences"


def words_of_codes() -> dict[str, dict[str, list[tuple[int, str, str]]]]:
    """By kind and variable: severity, label and sentence of each code, for the browser.

    >>> words_of_codes()["line"]["Inverse.Edge"][1][:2]
    (0, 'P to A')
    """
    return {
        kind: {
            name: [(int(_severity(code)), code.label, _sentence(kind, code)) for code in codes]
            for name, codes in by_name.items()
        }
        for kind, by_name in _CODES.items()
    }


def _sentence(kind: PartKind, code: Described) -> str:
    """Of an axis, the inverse's flow means speed."""
    if kind is not PartKind.AXIS or not isinstance(code, InverseStatus):
        return code.sentence
    words = code.sentence
    for of_flow, of_speed in _OF_SPEED:
        words = words.replace(of_flow, of_speed)
    return words


def _severity(code: Described) -> Severity:
    if isinstance(code, AxisStatus):
        return AXIS_SEVERITIES.get(code, Severity.WARNING)
    return INVERSE_SEVERITIES[code] if isinstance(code, InverseStatus) else Severity.GOOD


class MachineParts:
    """Finds and describes the variables of the lines and axes in view.

    Parameters
    ----------
    client
        Client of the service.
    store
        Receives the descriptions.
    """

    def __init__(self, client: Client, store: Store) -> None:
        self._client, self._store = client, store
        self._variables: dict[int, tuple[str, ...]] = {}

    def forget(self) -> None:
        """Look for all variables again, after a reconnect."""
        self._variables.clear()

    async def watch(self, parts: Mapping[int, Part]) -> None:
        """Find the variables of parts that were not in view before.

        Raises
        ------
        SourceLost, SourceRejected
        """
        for number, part in parts.items():
            if number not in self._variables:
                names = await self._find(part)
                await self._describe(number, part, names)
                self._variables[number] = names

    def due(self, numbers: set[int]) -> Iterator[tuple[int, str]]:
        """Yield (number, variable name) of each variable to read in this round."""
        for number in sorted(numbers):
            for name in self._variables.get(number, ()):
                yield number, name

    async def _find(self, part: Part) -> tuple[str, ...]:
        found = []
        for child in await self._client.browse(part.name):
            if child.is_variable:
                found.append(child.id)
            elif child.id.rpartition(".")[2] in _OBJECTS[part.kind]:
                found += [c.id for c in await self._client.browse(child.id) if c.is_variable]
        own = (id_.removeprefix(f"{part.name}.") for id_ in found)
        return tuple(name for name in own if name.rpartition(".")[2] not in _LEFT_OUT)

    async def _describe(self, number: int, part: Part, names: Sequence[str]) -> None:
        found = await self._client.engineering([f"{part.name}.{name}" for name in names])
        for name, texts in (
            (_NAMES, list(names)),
            (_UNITS, [one.unit for one in found]),
            (_SENTENCES, [one.description for one in found]),
        ):
            self._store.put(number, name, texts, 0, 0)
