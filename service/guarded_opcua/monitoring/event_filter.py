"""EventFilters (Part 4, 7.22.3 and 7.7).

A filter comes from a peer, so it is checked on creation: an accepted filter is evaluated in bounded
time, and operands that cannot be compared yield null (Part 4, table 121).
"""

import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.monitoring.events import Event
from guarded_opcua.monitoring.like_operator import MAX_PATTERN, like

_Codes = ua.StatusCodes
_Operator = ua.FilterOperator
_HAS_SUBTYPE = ua.NodeId(ua.ObjectIds.HasSubtype)
_BASE_EVENT = ua.NodeId(ua.ObjectIds.BaseEventType)
_CONDITION = ua.NodeId(ua.ObjectIds.ConditionType)
_MAX_SELECT_CLAUSES = 200  # asyncua's client selects all fields of a type, about 110
_MAX_WHERE_ELEMENTS = 20
_MAX_OPERANDS = 100
_MAX_DEPTH = 50
_CONDITION_ID = ""  # path of the ConditionId, which is not a field of an event

_COMPARISONS: dict[ua.FilterOperator, Callable[[Any, Any], Any]] = {
    _Operator.Equals: operator.eq,
    _Operator.GreaterThan: operator.gt,
    _Operator.LessThan: operator.lt,
    _Operator.GreaterThanOrEqual: operator.ge,
    _Operator.LessThanOrEqual: operator.le,
    _Operator.BitwiseAnd: operator.and_,
    _Operator.BitwiseOr: operator.or_,
}
_FEWEST_AND_MOST = {
    **dict.fromkeys(_COMPARISONS, (2, 2)),
    _Operator.IsNull: (1, 1),
    _Operator.Like: (2, 2),
    _Operator.Not: (1, 1),
    _Operator.Between: (3, 3),
    _Operator.InList: (2, _MAX_OPERANDS),
    _Operator.And: (2, 2),
    _Operator.Or: (2, 2),
    _Operator.OfType: (1, 1),
}


class EventFilterRefused(Exception):  # noqa: N818 - it is an answer
    """A filter is invalid or not supported."""


def filter_of_fields(paths: Iterable[str]) -> ua.EventFilter:
    """Return a filter that selects fields by browse path and passes every event."""
    clauses = [
        ua.SimpleAttributeOperand(
            _BASE_EVENT,
            [ua.QualifiedName(part) for part in path.split("/")],
            ua.AttributeIds.Value,
        )
        for path in paths
    ]
    return ua.EventFilter(SelectClauses=clauses)


class EventFilter:
    """A client's EventFilter, validated.

    Parameters
    ----------
    aspace
        Address space with the event types.
    wish
        The client's filter.

    Attributes
    ----------
    results
        Status code of each select clause.

    Raises
    ------
    EventFilterRefused
    """

    def __init__(self, aspace: AddressSpace, wish: object) -> None:
        if not isinstance(wish, ua.EventFilter):
            raise EventFilterRefused
        clauses = wish.SelectClauses or []
        if not 0 < len(clauses) <= _MAX_SELECT_CLAUSES:
            raise EventFilterRefused
        self.results = [_select_result(aspace, clause) for clause in clauses]
        self._aspace = aspace
        self._kinds: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        self._paths = [
            _path(clause) if code == _Codes.Good else None
            for clause, code in zip(clauses, self.results, strict=True)
        ]
        elements = wish.WhereClause.Elements if wish.WhereClause is not None else None
        self._where: Sequence[ua.ContentFilterElement] = elements or ()
        _check_where(aspace, self._where)

    @property
    def result(self) -> ua.EventFilterResult:
        """The EventFilterResult for the client."""
        codes = [ua.StatusCode(code) for code in self.results]
        return ua.EventFilterResult(SelectClauseResults=codes)

    def __len__(self) -> int:
        """Return the number of selected fields."""
        return len(self._paths)

    @property
    def judges(self) -> bool:
        """Whether the filter has a where clause."""
        return bool(self._where)

    def passes(self, event: Event) -> bool:
        """Return whether an event passes the filter."""
        return not self._where or self._judge(0, event) is True

    def select(self, event: Event) -> list[ua.Variant]:
        """Return the selected fields; fields that the event lacks are null."""
        found = (None if path is None else _field(path, event) for path in self._paths)
        return [ua.Variant() if field is None else field for field in found]

    def _judge(  # noqa: PLR0911 - one per operator
        self, number: int, event: Event
    ) -> Any:  # noqa: ANN401 - any value, None: null
        element = self._where[number]
        kind = element.FilterOperator
        values = (self._value(operand, event) for operand in element.FilterOperands)
        match kind:
            case _Operator.And | _Operator.Or:
                return _joined(list(values), decisive=kind == _Operator.Or)
            case _Operator.Not:
                value = _truth(next(values))
                return None if value is None else not value
            case _Operator.IsNull:
                return next(values) is None
            case _Operator.OfType:
                return next(values) in self._types_above(event.kind)
            case _Operator.InList:
                return _in_list(list(values))
            case _Operator.Between:
                value, low, high = values
                return _joined(
                    [_compared(operator.ge, value, low), _compared(operator.le, value, high)],
                    decisive=False,
                )
            case _Operator.Like:
                text, pattern = values
                known = isinstance(text, str) and isinstance(pattern, str)
                return like(text, pattern) if known else None
            case _:
                left, right = values
                return _compared(_COMPARISONS[kind], left, right)

    def _value(self, operand: object, event: Event) -> Any:  # noqa: ANN401 - any value
        if isinstance(operand, ua.ElementOperand):
            return self._judge(operand.Index, event)
        if isinstance(operand, ua.LiteralOperand):
            variant = operand.Value
        else:
            assert isinstance(operand, ua.SimpleAttributeOperand)  # noqa: S101 - was checked
            variant = _field(_path(operand), event)
        return None if variant is None else _plain(variant.Value)

    def _types_above(self, kind: ua.NodeId) -> frozenset[ua.NodeId]:
        if kind not in self._kinds:  # at most one entry per event type of the server
            self._kinds[kind] = frozenset(types_above(self._aspace, kind))
        return self._kinds[kind]


def types_above(aspace: AddressSpace, kind: ua.NodeId) -> list[ua.NodeId]:
    """Return a type and all its supertypes."""
    found = [kind]
    while len(found) < _MAX_DEPTH:
        node = aspace.get(found[-1])
        above = [
            reference.NodeId
            for reference in (node.references if node is not None else ())
            if not reference.IsForward and reference.ReferenceTypeId == _HAS_SUBTYPE
        ]
        if not above:
            break
        found.append(above[0])
    return found


def _select_result(aspace: AddressSpace, clause: ua.SimpleAttributeOperand) -> int:
    kind = clause.TypeDefinitionId
    if kind is not None and not kind.is_null() and _BASE_EVENT not in types_above(aspace, kind):
        return _Codes.BadTypeDefinitionInvalid
    if len(clause.BrowsePath or ()) > _MAX_DEPTH:
        return _Codes.BadBrowseNameInvalid
    if clause.IndexRange:
        return _Codes.BadIndexRangeInvalid
    return _Codes.Good if _is_field(aspace, clause) else _Codes.BadAttributeIdInvalid


def _is_field(aspace: AddressSpace, clause: ua.SimpleAttributeOperand) -> bool:
    """Return whether an operand is valid: a value, or the ConditionId (Part 9, 5.5.2)."""
    if clause.BrowsePath:
        return bool(clause.AttributeId == ua.AttributeIds.Value)
    kind = clause.TypeDefinitionId
    is_condition = kind is not None and _CONDITION in types_above(aspace, kind)
    return is_condition and bool(clause.AttributeId == ua.AttributeIds.NodeId)


def _path(clause: ua.SimpleAttributeOperand) -> str:
    return "/".join(part.Name or "" for part in clause.BrowsePath or ()) or _CONDITION_ID


def _field(path: str, event: Event) -> ua.Variant | None:
    if path != _CONDITION_ID:
        return event.fields.get(path)
    return None if event.condition is None else ua.Variant(event.condition, ua.VariantType.NodeId)


def _check_where(aspace: AddressSpace, elements: Sequence[ua.ContentFilterElement]) -> None:
    if len(elements) > _MAX_WHERE_ELEMENTS:
        raise EventFilterRefused
    used: set[int] = set()
    patterns = sum(_length_of_pattern(element) for element in elements)
    if patterns > MAX_PATTERN:  # total: matching costs pattern length × text length
        raise EventFilterRefused
    for number, element in enumerate(elements):
        fewest, most = _FEWEST_AND_MOST.get(element.FilterOperator, (1, 0))
        operands = element.FilterOperands or ()
        if not fewest <= len(operands) <= most:
            raise EventFilterRefused
        for operand in operands:
            if isinstance(operand, ua.ElementOperand):
                # forward and once, so that evaluation terminates (Part 4, 7.7.4.2)
                if not number < operand.Index < len(elements) or operand.Index in used:
                    raise EventFilterRefused
                used.add(operand.Index)
            else:
                _check_operand(aspace, operand)


def _check_operand(aspace: AddressSpace, operand: object) -> None:
    if isinstance(operand, ua.SimpleAttributeOperand):
        too_long = len(operand.BrowsePath or ()) > _MAX_DEPTH
        if operand.IndexRange or too_long or not _is_field(aspace, operand):
            raise EventFilterRefused
    elif not isinstance(operand, ua.LiteralOperand):
        raise EventFilterRefused


def _length_of_pattern(element: ua.ContentFilterElement) -> int:
    operands = element.FilterOperands or ()
    if element.FilterOperator != _Operator.Like or not operands:
        return 0
    pattern = operands[-1]
    if isinstance(pattern, ua.LiteralOperand):
        return len(pattern.Value.Value) if isinstance(pattern.Value.Value, str) else 0
    return MAX_PATTERN


def _plain(value: Any) -> Any:  # noqa: ANN401 - any value
    if isinstance(value, ua.LocalizedText):
        return value.Text
    return value.Name if isinstance(value, ua.QualifiedName) else value


def _truth(value: Any) -> bool | None:  # noqa: ANN401 - any value
    return value if isinstance(value, bool) else None


def _joined(values: list[Any], *, decisive: bool) -> bool | None:
    """Evaluate Or (``decisive`` True) or And (False) in three-valued logic."""
    truths = [_truth(value) for value in values]
    if decisive in truths:
        return decisive
    return None if None in truths else not decisive


def _in_list(values: list[Any]) -> bool | None:
    return _joined([_compared(operator.eq, values[0], v) for v in values[1:]], decisive=True)


def _compared(compare: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:  # noqa: ANN401
    if left is None or right is None:
        return None
    try:
        return compare(left, right)
    except TypeError:
        return None
