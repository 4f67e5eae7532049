"""The monitored item service set: create, modify, delete, trigger (Part 4, 5.12)."""

from asyncua import ua

from guarded_opcua.binary.encoding import encode_status, encode_structure
from guarded_opcua.sessions.operations import Operations, refusal
from guarded_opcua.sessions.requests import Handlers, Request
from guarded_opcua.subscriptions.registry import Subscriptions

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_refused_item = refusal(ua.MonitoredItemCreateResult)
_refused_change = refusal(ua.MonitoredItemModifyResult)


class ItemServices:
    """Answers the services of monitored items."""

    def __init__(self, operations: Operations, subscriptions: Subscriptions) -> None:
        self._operations = operations
        self._subscriptions = subscriptions
        self.handlers: Handlers = {
            _Ids.CreateMonitoredItemsRequest_Encoding_DefaultBinary: (
                ua.CreateMonitoredItemsParameters,
                self._create_items,
            ),
            _Ids.ModifyMonitoredItemsRequest_Encoding_DefaultBinary: (
                ua.ModifyMonitoredItemsParameters,
                self._modify_items,
            ),
            _Ids.DeleteMonitoredItemsRequest_Encoding_DefaultBinary: (
                ua.DeleteMonitoredItemsParameters,
                self._delete_items,
            ),
            _Ids.SetMonitoringModeRequest_Encoding_DefaultBinary: (
                ua.SetMonitoringModeParameters,
                self._set_monitoring_mode,
            ),
            _Ids.SetTriggeringRequest_Encoding_DefaultBinary: (
                ua.SetTriggeringParameters,
                self._set_triggering,
            ),
        }

    async def _create_items(
        self, request: Request, params: ua.CreateMonitoredItemsParameters
    ) -> bytes:
        number, stamps = params.SubscriptionId, params.TimestampsToReturn

        async def create(item: ua.MonitoredItemCreateRequest) -> bytes:
            return encode_structure(
                self._subscriptions.items.create(request.session, number, item, stamps)
            )

        kind = _Ids.CreateMonitoredItemsResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.ItemsToCreate, create, _refused_item
        )

    async def _modify_items(
        self, request: Request, params: ua.ModifyMonitoredItemsParameters
    ) -> bytes:
        number, stamps = params.SubscriptionId, params.TimestampsToReturn

        async def modify(item: ua.MonitoredItemModifyRequest) -> bytes:
            return encode_structure(
                self._subscriptions.items.modify(request.session, number, item, stamps)
            )

        kind = _Ids.ModifyMonitoredItemsResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.ItemsToModify, modify, _refused_change
        )

    async def _delete_items(
        self, request: Request, params: ua.DeleteMonitoredItemsParameters
    ) -> bytes:
        session, number = request.session, params.SubscriptionId

        async def delete(item: int) -> bytes:
            return encode_status(self._subscriptions.items.delete(session, number, item))

        kind = _Ids.DeleteMonitoredItemsResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.MonitoredItemIds, delete, encode_status
        )

    async def _set_monitoring_mode(
        self, request: Request, params: ua.SetMonitoringModeParameters
    ) -> bytes:
        session, number, mode = request.session, params.SubscriptionId, params.MonitoringMode

        async def switch(item: int) -> bytes:
            return encode_status(
                self._subscriptions.items.set_monitoring(session, number, item, mode)
            )

        kind = _Ids.SetMonitoringModeResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.MonitoredItemIds, switch, encode_status
        )

    async def _set_triggering(self, request: Request, params: ua.SetTriggeringParameters) -> bytes:
        add, remove = list(params.LinksToAdd or ()), list(params.LinksToRemove or ())
        self._operations.check_count([*add, *remove])
        session, items = request.session, self._subscriptions.items
        where = params.SubscriptionId, params.TriggeringItemId

        async def unlink(linked: int) -> bytes:
            return encode_status(items.unlink(session, *where, linked))

        async def link(linked: int) -> bytes:
            return encode_status(items.link(session, *where, linked))

        removed = await self._operations.each(request, remove, unlink, encode_status)
        added = await self._operations.each(request, add, link, encode_status)
        kind = _Ids.SetTriggeringResponse_Encoding_DefaultBinary
        return self._operations.results(request, kind, added, removed)
