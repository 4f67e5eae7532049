"""The inside of a server: nodes, values, histories and conditions, as their owner handles them."""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

from asyncua import ua

from guarded_opcua.address_space.blocks import Block
from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.address_space.insertion import reference
from guarded_opcua.address_space.packed_nodes import is_below
from guarded_opcua.address_space.removal import remove
from guarded_opcua.clock import Clock
from guarded_opcua.conditions.calls import Conditions
from guarded_opcua.conditions.condition import Condition, ConditionKey
from guarded_opcua.conditions.keeper import ConditionKeeper
from guarded_opcua.conditions.nodes import ConditionNodes, references_to
from guarded_opcua.history.events import EventHistorian
from guarded_opcua.history.historian import Historian
from guarded_opcua.history.offers import offer_events, offer_values, state_stored_fields
from guarded_opcua.history.reading import Histories
from guarded_opcua.local_blocks import LocalBlocks
from guarded_opcua.monitoring.events import event_of_asyncua
from guarded_opcua.settings import ServerSettings

_EMITS = 1 << ua.EventNotifier.SubscribeToEvents


class LocalServer(LocalBlocks):
    """A server that only its owner can reach: nodes, values, histories, conditions.

    Attributes
    ----------
    conditions
        Reports changed conditions as events; ConditionRefresh returns their state later.
    events
        Emits events, also to clients that lost their sessions by what happened and reconnect.
    """

    def __init__(self, settings: ServerSettings, clock: Clock | None = None) -> None:
        super().__init__(settings, clock)
        aspace = self._inside.aspace
        self.events = self._subscriptions.events
        self._inside.hand_events_to(self._trigger_event_of_asyncua)
        self._histories = Histories(settings.limits, aspace)
        self.conditions = Conditions(
            self._subscriptions, ConditionNodes(aspace, self._write_data_value), self._clock
        )
        self._has_history = self._has_past_events = False

    def remove(self, folders: Collection[ua.NodeId], referrers: Collection[ua.NodeId]) -> None:
        """Remove folders and all nodes below; their monitored items report BadNodeIdUnknown.

        Parameters
        ----------
        folders
            As in :meth:`add_later`.
        referrers
            All nodes that refer to them.
        """
        names = {(folder.NamespaceIndex, str(folder.Identifier)) for folder in folders}
        places, gone = self._subscriptions.items.blocks, dict[Block, set[int]]()
        for id_ in list(places):
            if is_below(id_.NamespaceIndex, str(id_.Identifier), names):
                block, column = places.pop(id_)
                gone.setdefault(block, set()).add(column)
        for block, columns in gone.items():
            block.take(block.unknown(sorted(columns), self._clock.now()))
        removed = remove(self._inside.aspace, folders, referrers, self._clock.now())
        for id_ in removed:
            self._variables.pop(id_, None)
            self._methods.pop(id_, None)
        self.conditions.nodes.forget(removed)

    def add_history(self, variables: Sequence[Variable], historian: Historian) -> None:
        """Offer HistoryRead of variables; the historian is queried with each request.

        Call it before the start, even with no variables yet, so that the server announces
        HistoryRead in its capabilities.

        Raises
        ------
        ServerError
            if a variable is not a scalar number.
        """
        self._has_history = True
        for variable in variables:
            offer_values(self._inside.aspace, variable)
            self._histories.add(variable, historian)

    def add_event_history(
        self, sources: Iterable[ua.NodeId], historian: EventHistorian, fields: Iterable[str]
    ) -> None:
        """Offer HistoryRead of the events of objects; call it before the start.

        Parameters
        ----------
        sources
            The objects; all share the property HistoricalEventFilter (Part 11, 5.3.2).
        historian
            Stores the events.
        fields
            Browse paths of the event fields that are stored; the first call sets them for all.
        """
        if not self._has_past_events:
            self._has_past_events = True
            state_stored_fields(self._inside.aspace, fields)
        for source in sources:
            offer_events(self._inside.aspace, source)
            self._histories.add_events(source, historian)

    def keep_conditions(self, keeper: ConditionKeeper) -> None:
        """Let clients acknowledge, confirm, comment on and refresh the conditions of a keeper."""
        self.conditions.keeper = keeper

    def add_condition(self, folder: ua.NodeId, condition: Callable[[], Condition]) -> None:
        """Expose a condition as nodes below an object, created on first access.

        Parameters
        ----------
        folder
            The condition's own object, of the condition's type, without children.
        condition
            Returns the state of the condition at that time.
        """
        added_at = self._added_at()

        async def make() -> None:
            self.conditions.nodes.make(condition(), added_at)

        self.add_later(folder, make)

    def let_emit(self, source: ua.NodeId, notifier: ua.NodeId | None = None) -> None:
        """Let clients subscribe to the events of an object.

        Parameters
        ----------
        source
            The object.
        notifier
            Object that gets a HasNotifier reference to the source; None: no object. The reference
            is hierarchical, so browsers show the source below the notifier, too.
        """
        aspace = self._inside.aspace
        own = aspace[source]
        if notifier is not None:
            kind, above = ua.NodeId(ua.ObjectIds.HasNotifier), aspace[notifier]
            above.references.append(reference(kind, own, forward=True))
            own.references.append(reference(kind, above, forward=False))
        emits = ua.DataValue(ua.Variant(_EMITS, ua.VariantType.Byte))
        own.attributes[ua.AttributeIds.EventNotifier].value = emits

    def refer_to_conditions(self, source: ua.NodeId, conditions: Iterable[ConditionKey]) -> None:
        """Add references from an object to its conditions, whose nodes need not exist yet."""
        self._inside.aspace[source].references.extend(references_to(conditions))

    def _trigger_event_of_asyncua(self, event: Any) -> None:  # noqa: ANN401 - asyncua's
        self.events.trigger(event_of_asyncua(event))
