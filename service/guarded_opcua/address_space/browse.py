"""Browse and TranslateBrowsePathsToNodeIds (Part 4, 5.9)."""

import dataclasses
import secrets
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.settings import Limits

_Codes = ua.StatusCodes
_HAS_SUBTYPE = ua.NodeId(ua.ObjectIds.HasSubtype)
_MAX_TARGETS = 1_000
_MAX_PATH = 50
_MASKED = (
    (ua.BrowseResultMask.ReferenceTypeId, "ReferenceTypeId", ua.NodeId()),
    (ua.BrowseResultMask.IsForward, "IsForward", False),
    (ua.BrowseResultMask.NodeClass, "NodeClass", ua.NodeClass.Unspecified),
    (ua.BrowseResultMask.BrowseName, "BrowseName", ua.QualifiedName()),
    (ua.BrowseResultMask.DisplayName, "DisplayName", ua.LocalizedText()),
    (ua.BrowseResultMask.TypeDefinition, "TypeDefinition", ua.ExpandedNodeId()),
)
_ALL = sum(int(mask) for mask, _, _ in _MASKED)


@dataclass(frozen=True)
class Continuation:
    """The remaining references of a Browse."""

    rest: tuple[ua.ReferenceDescription, ...]
    page: int


Breathe = Callable[[], Awaitable[None]]
Continuations = OrderedDict[bytes, Continuation]


class View:
    """Answers Browse and TranslateBrowsePathsToNodeIds."""

    def __init__(self, aspace: AddressSpace, limits: Limits) -> None:
        self._aspace = aspace
        self._limits = limits
        self._subtypes: dict[ua.NodeId, frozenset[ua.NodeId]] = {}

    def forget_types(self) -> None:
        """Clear the cached subtypes of reference types after nodes were added."""
        self._subtypes.clear()

    def browse(
        self,
        params: ua.BrowseParameters,
        wanted: ua.BrowseDescription,
        continuations: Continuations,
    ) -> ua.BrowseResult:
        """Browse one node; store the remaining references behind a continuation point."""
        if params.View is not None and not params.View.ViewId.is_null():
            return _fault(_Codes.BadViewIdUnknown)
        most = self._limits.references_per_node
        page = min(params.RequestedMaxReferencesPerNode or most, most)
        return self._browse(wanted, page, continuations)

    def browse_next(
        self, point: bytes, continuations: Continuations, *, release: bool
    ) -> ua.BrowseResult:
        """Return the next references, or release the continuation point."""
        found = continuations.pop(point, None)
        if found is None:
            return _fault(_Codes.BadContinuationPointInvalid)
        if release:
            return ua.BrowseResult()
        return self._page(found.rest, found.page, continuations)

    def _browse(
        self, wanted: ua.BrowseDescription, page: int, continuations: Continuations
    ) -> ua.BrowseResult:
        node = self._aspace.get(wanted.NodeId)
        if node is None:
            return _fault(_Codes.BadNodeIdUnknown)
        reference_type = wanted.ReferenceTypeId
        types: frozenset[ua.NodeId] | None = None
        if not reference_type.is_null():
            if not self._is_reference_type(reference_type):
                return _fault(_Codes.BadReferenceTypeIdInvalid)
            types = (
                self._closure(reference_type)
                if wanted.IncludeSubtypes
                else frozenset((reference_type,))
            )
        direction, classes = wanted.BrowseDirection, wanted.NodeClassMask
        if direction not in (
            ua.BrowseDirection.Forward,
            ua.BrowseDirection.Inverse,
            ua.BrowseDirection.Both,
        ):
            return _fault(_Codes.BadBrowseDirectionInvalid)
        found = [
            reference
            for reference in node.references
            if (
                direction == ua.BrowseDirection.Both
                or reference.IsForward == (direction == ua.BrowseDirection.Forward)
            )
            and (types is None or reference.ReferenceTypeId in types)
            and (not classes or reference.NodeClass & classes)
        ]
        mask = wanted.ResultMask
        if mask & _ALL != _ALL:
            found = [_masked(reference, mask) for reference in found]
        return self._page(tuple(found), page, continuations)

    def _page(
        self,
        references: tuple[ua.ReferenceDescription, ...],
        page: int,
        continuations: Continuations,
    ) -> ua.BrowseResult:
        result = ua.BrowseResult(References=list(references[:page]))
        if len(references) > page:
            if len(continuations) >= self._limits.continuation_points:
                return _fault(_Codes.BadNoContinuationPoints)
            point = secrets.token_bytes(16)
            continuations[point] = Continuation(references[page:], page)
            result.ContinuationPoint = point
        return result

    async def translate(  # noqa: PLR0911 - one per reason
        self, path: ua.BrowsePath, breathe: Breathe
    ) -> ua.BrowsePathResult:
        """Return the targets of a browse path; ``breathe`` is awaited between nodes."""
        elements = path.RelativePath.Elements
        if not elements:
            return _no_path(_Codes.BadNothingToDo)
        if len(elements) > _MAX_PATH:
            return _no_path(_Codes.BadTooManyOperations)
        if elements[-1].TargetName is None or not elements[-1].TargetName.Name:
            return _no_path(_Codes.BadBrowseNameInvalid)
        if path.StartingNode not in self._aspace:
            return _no_path(_Codes.BadNodeIdUnknown)
        reached: dict[ua.NodeId, None] = {path.StartingNode: None}
        for element in elements:
            found: dict[ua.NodeId, None] = {}
            for nodeid in reached:
                found.update(dict.fromkeys(self._step(nodeid, element)))
                if len(found) > _MAX_TARGETS:
                    return _no_path(_Codes.BadTooManyMatches)
                await breathe()
            reached = found
            if not reached:
                return _no_path(_Codes.BadNoMatch)
        targets = [
            ua.BrowsePathTarget(TargetId=nodeid, RemainingPathIndex=2**32 - 1) for nodeid in reached
        ]
        return ua.BrowsePathResult(Targets=targets)

    def _step(self, nodeid: ua.NodeId, element: ua.RelativePathElement) -> list[ua.NodeId]:
        node = self._aspace.get(nodeid)
        if node is None:
            return []
        wanted, types = element.ReferenceTypeId, None
        if not wanted.is_null():
            types = self._closure(wanted) if element.IncludeSubtypes else frozenset((wanted,))
        name = element.TargetName
        return [
            reference.NodeId
            for reference in node.references
            if reference.IsForward != element.IsInverse
            and (types is None or reference.ReferenceTypeId in types)
            and (name is None or not name.Name or reference.BrowseName == name)
        ]

    def _is_reference_type(self, nodeid: ua.NodeId) -> bool:
        held = self._aspace.read_attribute_value(nodeid, ua.AttributeIds.NodeClass)
        return held.Value is not None and held.Value.Value == ua.NodeClass.ReferenceType

    def _closure(self, reference_type: ua.NodeId) -> frozenset[ua.NodeId]:
        known = self._subtypes.get(reference_type)
        if known is not None:
            return known
        found = {reference_type}
        open_ = [reference_type]
        while open_:
            node = self._aspace.get(open_.pop())
            for reference in node.references if node is not None else ():
                if (
                    reference.IsForward
                    and reference.ReferenceTypeId == _HAS_SUBTYPE
                    and reference.NodeId not in found
                ):
                    found.add(reference.NodeId)
                    open_.append(reference.NodeId)
        closure = frozenset(found)
        if self._is_reference_type(reference_type):
            self._subtypes[reference_type] = closure
        return closure


def _masked(reference: ua.ReferenceDescription, mask: int) -> ua.ReferenceDescription:
    hidden = {name: empty for bit, name, empty in _MASKED if not mask & bit}
    return dataclasses.replace(reference, **hidden)


def _fault(code: int) -> ua.BrowseResult:
    return ua.BrowseResult(StatusCode=ua.StatusCode(code))


def _no_path(code: int) -> ua.BrowsePathResult:
    return ua.BrowsePathResult(StatusCode=ua.StatusCode(code))
