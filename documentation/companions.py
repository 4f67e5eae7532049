"""Extracts of the OPC Foundation's NodeSets that the results server uses.

DI and Machinery for name plates and health; PA-DIM and Machinery Process Values for signals.

``python -m documentation.companions FOLDER`` regenerates them from the NodeSets in a folder. They
come from the npm package node-opcua-nodesets, pinned by
``tests/opcua/node_peer/package-lock.json``.
"""

import re
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

KEPT = Path(__file__).parents[1] / "service" / "valvemap" / "opcua_results" / "node_sets"
_NODES = "http://opcfoundation.org/UA/2011/03/UANodeSet.xsd"
_VALUES = "http://opcfoundation.org/UA/2008/02/Types.xsd"
_STANDARD = "http://opcfoundation.org/UA/"
_HAS_SUBTYPE, _HAS_INTERFACE = "i=45", "i=17603"

Key = tuple[str, str]  # namespace URI, identifier


@dataclass(frozen=True)
class Part:
    """An extract of a NodeSet: nodes by their numeric ids, with all nodes they depend on.

    ``left_out`` are optional parts of types, of which no instance here has one.
    """

    original: str
    kept: str
    wanted: tuple[int, ...]
    left_out: tuple[int, ...] = ()


PARTS = (
    Part(
        "Opc.Ua.Di.NodeSet2.xml",
        "di.NodeSet2.xml",
        (
            5001,  # DeviceSet
            15001,  # NamespaceMetadata
            15035,  # IVendorNameplateType
            15048,  # ITagNameplateType
            15051,  # IDeviceHealthType
        ),
    ),
    Part(
        "Opc.Ua.Machinery.NodeSet2.xml",
        "machinery.NodeSet2.xml",
        (
            1005,  # MachineryComponentIdentificationType
            1011,  # IMachineTagNameplateType
            5001,  # NamespaceMetadata
        ),
    ),
    Part(
        "Opc.Ua.PADIM.NodeSet2.xml",
        "padim.NodeSet2.xml",
        (
            *range(1000, 1008),  # NamespaceMetadata, and its properties that refer to it
            1022,  # AnalogSignalType
        ),
        left_out=(
            1109,  # ZeroPointAdjustment
            1288,  # <SignalCalibrationIdentifier>
            1290,  # SignalConditionSet
        ),
    ),
    Part(
        "Opc.Ua.Machinery.ProcessValues.NodeSet2.xml",
        "process_values.NodeSet2.xml",
        (
            1003,  # ProcessValueType
            5001,  # NamespaceMetadata
        ),
        left_out=(
            5002,  # DeviationAlarm
            5004,  # LimitAlarm
            7001,  # ZeroPointAdjustment
        ),
    ),
)


class NodeSet:
    """One UANodeSet, with its elements by a key that is valid across files."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.root = ET.fromstring(text)  # noqa: S314 - a file of a pinned package, or our own
        uris = [one.text or "" for one in self.root.iterfind(f"{_tag('NamespaceUris')}/*")]
        self.uris = (_STANDARD, *uris)
        self.aliases = {
            one.get("Alias", ""): one.text or ""
            for one in self.root.iterfind(f"{_tag('Aliases')}/*")
        }
        self.nodes = {
            self.key(one.get("NodeId", "")): one for one in self.root if one.get("NodeId")
        }

    def models(self) -> list[ET.Element]:
        """Model elements of the node set."""
        return list(self.root.iterfind(f"{_tag('Models')}/*"))

    @property
    def own(self) -> str:
        """Namespace URI of its nodes."""
        return self.models()[0].get("ModelUri", "")

    def key(self, id_: str) -> Key:
        """Return the key of a NodeId, or of an alias, of this file."""
        id_ = self.aliases.get(id_, id_)
        found = re.fullmatch(r"(?:ns=(\d+);)?(.*)", id_)
        assert found is not None  # noqa: S101 - anything matches
        return self.uris[int(found[1] or 0)], found[2]

    def name(self, node: ET.Element) -> Key:
        """Return the namespace and text of a BrowseName."""
        index, _, text = node.get("BrowseName", "").partition(":")
        if not index.isdigit():
            return _STANDARD, node.get("BrowseName", "")
        return self.uris[int(index)], text

    def references(self, node: ET.Element) -> Iterator[tuple[Key, bool, Key]]:
        """Yield type, direction and target of a node's references."""
        for one in node.iterfind(f"{_tag('References')}/*"):
            yield (
                self.key(one.get("ReferenceType", "")),
                one.get("IsForward", "true") != "false",
                self.key(one.text or ""),
            )

    def needs(self, node: ET.Element) -> Iterator[Key]:
        """Yield the nodes that a node depends on; not its subtypes or implementations."""
        if node.get("DataType"):
            yield self.key(node.get("DataType", ""))
        for kind, forward, target in self.references(node):
            above = kind == (_STANDARD, _HAS_SUBTYPE)
            below = kind == (_STANDARD, _HAS_INTERFACE)
            if not (above and forward) and not (below and not forward):
                yield target


def cut(folder: Path) -> Mapping[str, str]:
    """Return file name and text of each extract, from the originals in a folder."""
    originals = [NodeSet((folder / part.original).read_text(encoding="utf-8")) for part in PARTS]
    kept = closure(originals)
    return {
        part.kept: _written(original, kept) for part, original in zip(PARTS, originals, strict=True)
    }


def closure(originals: Sequence[NodeSet]) -> set[Key]:
    """Return all extracted nodes: the wanted ones and their dependencies."""
    every = {key: (whole, node) for whole in originals for key, node in whole.nodes.items()}
    pairs = list(zip(PARTS, originals, strict=True))
    open_ = [(whole.own, f"i={number}") for part, whole in pairs for number in part.wanted]
    left_out = {(whole.own, f"i={number}") for part, whole in pairs for number in part.left_out}
    kept: set[Key] = set()
    while open_:
        key = open_.pop()
        if key in kept or key in left_out or key not in every:  # standard nodes always exist
            continue
        kept.add(key)
        whole, node = every[key]
        open_ += whole.needs(node)
    return kept


def _written(original: NodeSet, kept: Collection[Key]) -> str:
    ET.register_namespace("", _NODES)
    ET.register_namespace("uax", _VALUES)
    root = original.root
    used = {uri for uri, _ in kept} | {_STANDARD}
    for node in [one for key, one in original.nodes.items() if key not in kept]:
        root.remove(node)
    for node in root:
        _drop_references(original, node, kept)
    _drop(root, "Extensions")
    _renumber(original, [uri for uri in original.uris if uri in used])
    for model in root.iterfind(f"{_tag('Models')}/*"):
        for one in [one for one in model if one.get("ModelUri") not in used]:
            model.remove(one)
    aliases = root.find(_tag("Aliases"))
    assert aliases is not None  # noqa: S101 - all files have them
    for one in [one for one in aliases if original.key(one.text or "")[0] not in used]:
        aliases.remove(one)
    _say_that_it_is_a_part(root)
    ET.indent(root)
    licence = re.search(r"<!--.*?-->", original.text, re.DOTALL)
    assert licence is not None  # noqa: S101 - the files of the OPC Foundation begin with it
    head = '<?xml version="1.0" encoding="utf-8"?>\n'
    return f"{head}{licence[0]}\n{ET.tostring(root, 'unicode')}\n"


def _drop_references(original: NodeSet, node: ET.Element, kept: Collection[Key]) -> None:
    stated = node.find(_tag("References"))
    for one in list(stated) if stated is not None else ():
        key = original.key(one.text or "")
        if key[0] != _STANDARD and key not in kept:
            stated.remove(one)  # type: ignore[union-attr]


def _renumber(original: NodeSet, uris: Sequence[str]) -> None:
    """Keep these namespaces of a file alone, and change the indices of the others' in it."""
    root = original.root
    table = root.find(_tag("NamespaceUris"))
    assert table is not None  # noqa: S101 - every NodeSet has some
    for one in [one for one in table if one.text not in uris]:
        table.remove(one)
    number = {
        str(old): str(uris.index(uri)) for old, uri in enumerate(original.uris) if uri in uris
    }
    if all(old == new for old, new in number.items()):
        return
    for node in root.iter():
        if node.tag.startswith(f"{{{_VALUES}}}"):
            assert not node.tag.endswith(("NamespaceIndex", "NodeId"))  # noqa: S101 - none so far
            continue
        for name, text in node.attrib.items():
            node.set(name, _renumbered(text, number, is_name=name == "BrowseName"))
        if node.text:
            node.text = _renumbered(node.text, number, is_name=False)


def _renumbered(text: str, number: Mapping[str, str], *, is_name: bool) -> str:
    form = r"(\d+):" if is_name else r"ns=(\d+);"
    found = re.match(form, text)
    if found is None:
        return text
    return f"{text[: found.start(1)]}{number[found[1]]}{text[found.end(1) :]}"


def _say_that_it_is_a_part(root: ET.Element) -> None:
    for node in root.iterfind(f"{_tag('UAVariable')}[@BrowseName='IsNamespaceSubset']"):
        said = node.find(f"{_tag('Value')}/{{{_VALUES}}}Boolean")
        assert said is not None  # noqa: S101 - all metadata have it
        said.text = "true"


def _drop(root: ET.Element, tag: str) -> None:
    for one in root.findall(_tag(tag)):
        root.remove(one)


def _tag(name: str) -> str:
    return f"{{{_NODES}}}{name}"


def main(folder: Path) -> None:
    """Write the files."""
    KEPT.mkdir(exist_ok=True)
    for name, text in cut(folder).items():
        (KEPT / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
