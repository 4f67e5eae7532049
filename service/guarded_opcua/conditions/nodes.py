"""Nodes of conditions: created on first access, updated when the condition changes."""

from collections.abc import Callable, Iterable, Iterator

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.insertion import insert, reference
from guarded_opcua.binary.encoding import instant
from guarded_opcua.conditions.condition import Condition, ConditionKey

_Ids = ua.ObjectIds
_HAS_CONDITION = ua.NodeId(_Ids.HasCondition)
_HAS_COMPONENT = ua.NodeId(_Ids.HasComponent)
_HAS_PROPERTY = ua.NodeId(_Ids.HasProperty)
_TWO_STATES = ua.NodeId(_Ids.TwoStateVariableType)
_OF_CONDITION = ua.NodeId(_Ids.ConditionVariableType)
_COMPONENTS = {  # all others are properties
    "EnabledState": _TWO_STATES,
    "AckedState": _TWO_STATES,
    "ConfirmedState": _TWO_STATES,
    "ActiveState": _TWO_STATES,
    "Quality": _OF_CONDITION,
    "LastSeverity": _OF_CONDITION,
    "Comment": _OF_CONDITION,
    "LimitState": ua.NodeId(_Ids.ExclusiveLimitStateMachineType),
    "LimitState/CurrentState": ua.NodeId(_Ids.FiniteStateVariableType),
}
_UTC = ua.NodeId(_Ids.UtcTime)
METHODS = {
    "AddComment": ua.NodeId(_Ids.ConditionType_AddComment),
    "Acknowledge": ua.NodeId(_Ids.AcknowledgeableConditionType_Acknowledge),
    "Confirm": ua.NodeId(_Ids.AcknowledgeableConditionType_Confirm),
}

Write = Callable[[ua.NodeId, ua.DataValue], None]


class ConditionNodes:
    """The conditions whose nodes have been created.

    Parameters
    ----------
    aspace
        Address space of the server.
    write
        Publishes the value of a variable.
    """

    def __init__(self, aspace: AddressSpace, write: Write) -> None:
        self._aspace = aspace
        self._write = write
        self._made: set[ua.NodeId] = set()

    def __contains__(self, key: ConditionKey) -> bool:
        return key.id in self._made

    def make(self, condition: Condition, at: int) -> None:
        """Create the nodes below a condition's object, one for each event field."""
        id_ = condition.key.id
        for path, variant in condition.fields().items():
            self._add(id_, path, variant, at)
        own = self._aspace[id_]
        for method in METHODS.values():
            shown = reference(_HAS_COMPONENT, self._aspace[method], forward=True)
            own.references.append(shown)
        source = self._aspace[condition.key.source]
        own.references.append(reference(_HAS_CONDITION, source, forward=False))
        self._made.add(id_)
        self.show(condition)

    def forget(self, ids: Iterable[ua.NodeId]) -> None:
        """Unregister the conditions among removed nodes."""
        self._made.difference_update(ids)

    def show(self, condition: Condition) -> None:
        """Update the changed values of a condition, if its nodes exist."""
        if condition.key.id not in self._made:
            return
        moment = instant(max(condition.changed, condition.commented))
        for path, variant in condition.fields().items():
            id_ = _node_of(condition.key.id, path)
            value = ua.DataValue(variant, ua.StatusCode(), moment, moment)
            if self._aspace[id_].attributes[ua.AttributeIds.Value].value.Value != variant:
                self._write(id_, value)

    def _add(self, condition: ua.NodeId, path: str, variant: ua.Variant, at: int) -> None:
        above = path.rpartition("/")[0]
        parent = _node_of(condition, above) if above else condition
        if above and parent not in self._aspace:  # an object without a value
            self._insert(condition, parent, above, None, at)
        self._insert(parent, _node_of(condition, path), path, variant, at)

    def _insert(
        self, parent: ua.NodeId, id_: ua.NodeId, path: str, variant: ua.Variant | None, at: int
    ) -> None:
        name = path.rpartition("/")[2]
        item = ua.AddNodesItem()
        item.ParentNodeId, item.RequestedNewNodeId = parent, id_
        item.BrowseName = ua.QualifiedName(name, 0)
        kind = _COMPONENTS.get(path)
        item.ReferenceTypeId = _HAS_PROPERTY if kind is None else _HAS_COMPONENT
        item.TypeDefinition = kind or ua.NodeId(_Ids.PropertyType)
        shown = ua.LocalizedText(name)
        if variant is None:
            item.NodeClass = ua.NodeClass.Object
            item.NodeAttributes = ua.ObjectAttributes(DisplayName=shown, EventNotifier=0)
        else:
            item.NodeClass = ua.NodeClass.Variable
            level = 1 << ua.AccessLevel.CurrentRead
            is_time = variant.VariantType == ua.VariantType.DateTime
            item.NodeAttributes = ua.VariableAttributes(
                DisplayName=shown,
                DataType=_UTC if is_time else ua.NodeId(variant.VariantType.value),
                ValueRank=ua.ValueRank.Scalar,
                AccessLevel=level,
                UserAccessLevel=level,
                MinimumSamplingInterval=0.0,
                Value=variant,
            )
        insert(self._aspace, item, instant(at))


def references_to(keys: Iterable[ConditionKey]) -> Iterator[ua.ReferenceDescription]:
    """Return the references from a source to its conditions, whose nodes need not exist yet."""
    for key in keys:
        name = str(key.id.Identifier).rpartition(".")[2]
        yield ua.ReferenceDescription(
            ReferenceTypeId=_HAS_CONDITION,
            IsForward=True,
            NodeId=key.id,
            NodeClass=ua.NodeClass.Object,
            BrowseName=ua.QualifiedName(name, key.id.NamespaceIndex),
            DisplayName=ua.LocalizedText(name),
            TypeDefinition=key.type_definition,
        )


def _node_of(condition: ua.NodeId, path: str) -> ua.NodeId:
    name = f"{condition.Identifier}.{path.replace('/', '.')}"
    return ua.NodeId(name, condition.NamespaceIndex)
