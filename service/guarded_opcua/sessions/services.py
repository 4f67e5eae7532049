"""The services of a session: each request is checked, answered and counted (Part 4, 5)."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.address_space.attributes import Attributes
from guarded_opcua.address_space.browse import View
from guarded_opcua.audit import Actor, Audit
from guarded_opcua.binary.encoding import (
    encode_browse_response,
    encode_data_value,
    encode_history_response,
    encode_read_response,
    encode_republish_response,
    encode_structure,
    ticks_of_ns,
)
from guarded_opcua.caller import acting_for
from guarded_opcua.clock import Clock
from guarded_opcua.conditions.calls import Conditions
from guarded_opcua.history.reading import Histories
from guarded_opcua.sessions.session import Session
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.publish_queue import PublishRequest
from guarded_opcua.subscriptions.registry import Subscriptions

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_GET_MONITORED_ITEMS = ua.NodeId(_Ids.Server_GetMonitoredItems)
_RESEND_DATA = ua.NodeId(_Ids.Server_ResendData)


T = TypeVar("T")


class Turn(Protocol):
    """The running request's turn at the server."""

    async def breathe(self) -> None:
        """Let others go first if this request has lasted for long."""

    async def outside(self, slow: Awaitable[T]) -> T:
        """Wait for something slow without keeping the turn."""


@dataclass(frozen=True)
class Request:
    """One request of an active session."""

    session: Session
    request_id: int
    header: ua.RequestHeader
    turn: Turn

    @property
    def handle(self) -> int:
        """The client's own number of the request."""
        return int(self.header.RequestHandle)

    @property
    def actor(self) -> Actor:
        """Who asks."""
        return Actor(self.session, self.session.host, self.header.AuditEntryId or "")


Handler = Callable[[Request, Any], Awaitable[Any]]


class Services:
    """Answers the requests of active sessions."""

    def __init__(
        self,
        limits: Limits,
        clock: Clock,
        attributes: Attributes,
        view: View,
        subscriptions: Subscriptions,
        histories: Histories,
        conditions: Conditions,
        audit: Audit,
    ) -> None:
        self._limits = limits
        self._clock = clock
        self._attributes = attributes
        self._view = view
        self._subscriptions = subscriptions
        self._histories = histories
        self._conditions = conditions
        self._audit = audit
        self._handlers: dict[int, tuple[type, Handler]] = {
            _Ids.ReadRequest_Encoding_DefaultBinary: (ua.ReadParameters, self._read),
            _Ids.WriteRequest_Encoding_DefaultBinary: (ua.WriteParameters, self._write),
            _Ids.CallRequest_Encoding_DefaultBinary: (ua.CallParameters, self._call),
            _Ids.HistoryReadRequest_Encoding_DefaultBinary: (
                ua.HistoryReadParameters,
                self._history_read,
            ),
            _Ids.BrowseRequest_Encoding_DefaultBinary: (ua.BrowseParameters, self._browse),
            _Ids.BrowseNextRequest_Encoding_DefaultBinary: (
                ua.BrowseNextParameters,
                self._browse_next,
            ),
            _Ids.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary: (
                ua.TranslateBrowsePathsToNodeIdsParameters,
                self._translate,
            ),
            _Ids.RegisterNodesRequest_Encoding_DefaultBinary: (
                ua.RegisterNodesParameters,
                self._register_nodes,
            ),
            _Ids.UnregisterNodesRequest_Encoding_DefaultBinary: (
                ua.UnregisterNodesParameters,
                self._unregister_nodes,
            ),
            _Ids.CreateSubscriptionRequest_Encoding_DefaultBinary: (
                ua.CreateSubscriptionParameters,
                self._create_subscription,
            ),
            _Ids.ModifySubscriptionRequest_Encoding_DefaultBinary: (
                ua.ModifySubscriptionParameters,
                self._modify_subscription,
            ),
            _Ids.DeleteSubscriptionsRequest_Encoding_DefaultBinary: (
                ua.DeleteSubscriptionsParameters,
                self._delete_subscriptions,
            ),
            _Ids.SetPublishingModeRequest_Encoding_DefaultBinary: (
                ua.SetPublishingModeParameters,
                self._set_publishing_mode,
            ),
            _Ids.TransferSubscriptionsRequest_Encoding_DefaultBinary: (
                ua.TransferSubscriptionsParameters,
                self._transfer_subscriptions,
            ),
            _Ids.PublishRequest_Encoding_DefaultBinary: (ua.PublishParameters, self._publish),
            _Ids.RepublishRequest_Encoding_DefaultBinary: (ua.RepublishParameters, self._republish),
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
            _Ids.CancelRequest_Encoding_DefaultBinary: (ua.CancelParameters, self._cancel),
        }

    def parameters(self, service: object) -> type:
        """Return the type of a service's parameters.

        Raises
        ------
        ServiceError
            BadServiceUnsupported.
        """
        found = self._handlers.get(service) if isinstance(service, int) else None
        if found is None:
            raise ServiceError(_Codes.BadServiceUnsupported)
        return found[0]

    async def answer(self, service: int, request: Request, params: Any) -> Any:  # noqa: ANN401
        """Answer a request: a response, its encoded form, or None if it is answered later.

        Raises
        ------
        ServiceError
            what the fault says.
        """
        return await self._handlers[service][1](request, params)

    async def _read(self, request: Request, params: ua.ReadParameters) -> bytes:
        if params.MaxAge < 0:
            raise ServiceError(_Codes.BadMaxAgeInvalid)
        if params.TimestampsToReturn not in tuple(ua.TimestampsToReturn)[:4]:
            raise ServiceError(_Codes.BadTimestampsToReturnInvalid)
        self._check_count(params.NodesToRead)
        values, size = [], 0
        for wanted in params.NodesToRead:
            value = self._attributes.read(wanted, request.session.role)
            encoded = encode_data_value(value, params.TimestampsToReturn)
            size += len(encoded)
            if size > self._limits.response_bytes:
                raise ServiceError(_Codes.BadResponseTooLarge)
            values.append(encoded)
            await request.turn.breathe()
        return encode_read_response(request.handle, self._ticks(), values)

    async def _write(self, request: Request, params: ua.WriteParameters) -> ua.WriteResponse:
        self._check_count(params.NodesToWrite)
        actor, role = request.actor, request.session.role
        codes = []
        for item in params.NodesToWrite:
            before = self._attributes.held(item)
            with acting_for(_name(request.session)):
                code = await self._attributes.write(item, role, request.turn.outside)
            self._audit.written(actor, item, before, code)
            codes.append(ua.StatusCode(code))
            await request.turn.breathe()
        return ua.WriteResponse(Results=codes)

    async def _call(self, request: Request, params: ua.CallParameters) -> ua.CallResponse:
        self._check_count(params.MethodsToCall, self._limits.method_calls)
        results = []
        for wanted in params.MethodsToCall:
            result = await self._call_one(request, wanted)
            self._audit.called(request.actor, wanted, result.StatusCode.value)
            results.append(result)
            await request.turn.breathe()
        return ua.CallResponse(Results=results)

    async def _call_one(
        self, request: Request, wanted: ua.CallMethodRequest
    ) -> ua.CallMethodResult:
        session = request.session
        if wanted.MethodId in (_GET_MONITORED_ITEMS, _RESEND_DATA):
            return await self._call_for_session(request, wanted)
        with acting_for(_name(session)):
            if self._conditions.is_call(wanted):
                return await self._conditions.call(session, wanted, request.turn.outside)
            return await self._attributes.call(wanted, session.role, request.turn.outside)

    async def _call_for_session(
        self, request: Request, wanted: ua.CallMethodRequest
    ) -> ua.CallMethodResult:
        session, result = request.session, ua.CallMethodResult()
        given = wanted.InputArguments or []
        if len(given) != 1 or given[0].VariantType != ua.VariantType.UInt32:
            result.StatusCode = ua.StatusCode(_Codes.BadInvalidArgument)
            return result
        number = given[0].Value
        if self._subscriptions.by_number.get(number) is None:
            result.StatusCode = ua.StatusCode(_Codes.BadSubscriptionIdInvalid)
        elif number not in session.subscriptions:
            result.StatusCode = ua.StatusCode(_Codes.BadUserAccessDenied)
        elif wanted.MethodId == _RESEND_DATA:
            await self._subscriptions.resend(session, number, request.turn.breathe)
        else:
            pairs = self._subscriptions.items_of(session, number)
            result.OutputArguments = [
                ua.Variant([pair[side] for pair in pairs], ua.VariantType.UInt32, is_array=True)
                for side in (0, 1)
            ]
        return result

    async def _history_read(self, request: Request, params: ua.HistoryReadParameters) -> bytes:
        if params.TimestampsToReturn not in tuple(ua.TimestampsToReturn)[:3]:
            raise ServiceError(_Codes.BadTimestampsToReturnInvalid)
        self._check_count(params.NodesToRead, self._limits.history_reads)
        details = params.HistoryReadDetails
        if isinstance(details, ua.ReadProcessedDetails) and len(details.AggregateType) != len(
            params.NodesToRead
        ):
            raise ServiceError(_Codes.BadAggregateListMismatch)
        rests, results = request.session.rests, []
        for number, wanted in enumerate(params.NodesToRead):
            if params.ReleaseContinuationPoints:
                results.append(self._histories.release(wanted, rests))
            else:
                results.append(await self._histories.read(params, number, rests, request.turn))
            await request.turn.breathe()
        return encode_history_response(request.handle, self._ticks(), results)

    async def _browse(self, request: Request, params: ua.BrowseParameters) -> bytes:
        self._check_count(params.NodesToBrowse)
        continuations = request.session.continuations
        results, size = [], 0
        for wanted in params.NodesToBrowse:
            result = encode_structure(self._view.browse(params, wanted, continuations))
            size += len(result)
            if size > self._limits.response_bytes:
                raise ServiceError(_Codes.BadResponseTooLarge)
            results.append(result)
            await request.turn.breathe()
        return encode_browse_response(request.handle, self._ticks(), results)

    async def _browse_next(
        self, request: Request, params: ua.BrowseNextParameters
    ) -> ua.BrowseNextResponse:
        self._check_count(params.ContinuationPoints)
        results = self._view.browse_next(params, request.session.continuations)
        response = ua.BrowseNextResponse()
        response.Parameters.Results = results
        return response

    async def _translate(
        self, request: Request, params: ua.TranslateBrowsePathsToNodeIdsParameters
    ) -> ua.TranslateBrowsePathsToNodeIdsResponse:
        self._check_count(params.BrowsePaths)
        results = []
        for path in params.BrowsePaths:
            results.append(await self._view.translate(path, request.turn.breathe))
            await request.turn.breathe()
        return ua.TranslateBrowsePathsToNodeIdsResponse(Results=results)

    async def _register_nodes(
        self, _: Request, params: ua.RegisterNodesParameters
    ) -> ua.RegisterNodesResponse:
        self._check_count(params.NodesToRegister)
        response = ua.RegisterNodesResponse()
        response.Parameters.RegisteredNodeIds = params.NodesToRegister
        return response

    async def _unregister_nodes(
        self, _: Request, params: ua.UnregisterNodesParameters
    ) -> ua.UnregisterNodesResponse:
        self._check_count(params.NodesToUnregister)
        return ua.UnregisterNodesResponse()

    async def _create_subscription(
        self, request: Request, params: ua.CreateSubscriptionParameters
    ) -> ua.CreateSubscriptionResponse:
        result = self._subscriptions.create(request.session, params)
        return ua.CreateSubscriptionResponse(Parameters=result)

    async def _modify_subscription(
        self, request: Request, params: ua.ModifySubscriptionParameters
    ) -> ua.ModifySubscriptionResponse:
        result = self._subscriptions.modify(request.session, params)
        return ua.ModifySubscriptionResponse(Parameters=result)

    async def _delete_subscriptions(
        self, request: Request, params: ua.DeleteSubscriptionsParameters
    ) -> ua.DeleteSubscriptionsResponse:
        self._check_count(params.SubscriptionIds)
        codes = self._subscriptions.delete(request.session, params.SubscriptionIds)
        return ua.DeleteSubscriptionsResponse(Results=_statuses(codes))

    async def _set_publishing_mode(
        self, request: Request, params: ua.SetPublishingModeParameters
    ) -> ua.SetPublishingModeResponse:
        self._check_count(params.SubscriptionIds)
        codes = self._subscriptions.set_publishing(request.session, params)
        response = ua.SetPublishingModeResponse()
        response.Parameters.Results = _statuses(codes)
        return response

    async def _transfer_subscriptions(
        self, request: Request, params: ua.TransferSubscriptionsParameters
    ) -> ua.TransferSubscriptionsResponse:
        self._check_count(params.SubscriptionIds)
        results = await self._subscriptions.transfer(request.session, params, request.turn.breathe)
        response = ua.TransferSubscriptionsResponse()
        response.Parameters.Results = results
        return response

    async def _publish(self, request: Request, params: ua.PublishParameters) -> None:
        session = request.session
        if not session.subscriptions:
            raise ServiceError(_Codes.BadNoSubscription)
        acks = params.SubscriptionAcknowledgements or []
        if len(acks) > self._limits.operations:
            raise ServiceError(_Codes.BadTooManyOperations)
        results = self._subscriptions.acknowledge(session, acks)
        hint = request.header.TimeoutHint
        deadline = self._clock.monotonic() + hint / 1e3 if hint else float("inf")
        session.add_publish_request(
            PublishRequest(request.request_id, request.handle, results, deadline)
        )

    async def _republish(self, request: Request, params: ua.RepublishParameters) -> bytes:
        try:
            content = self._subscriptions.republish(request.session, params)
        except ServiceError:
            asyncio.get_running_loop().call_soon(request.session.nothing_to_ask_again)
            raise
        return encode_republish_response(request.handle, self._ticks(), content)

    async def _create_items(
        self, request: Request, params: ua.CreateMonitoredItemsParameters
    ) -> ua.CreateMonitoredItemsResponse:
        self._check_count(params.ItemsToCreate)
        results = []
        for item in params.ItemsToCreate:
            results.append(
                self._subscriptions.create_item(
                    request.session, params.SubscriptionId, item, params.TimestampsToReturn
                )
            )
            await request.turn.breathe()
        return ua.CreateMonitoredItemsResponse(Results=results)

    async def _modify_items(
        self, request: Request, params: ua.ModifyMonitoredItemsParameters
    ) -> ua.ModifyMonitoredItemsResponse:
        self._check_count(params.ItemsToModify)
        results = []
        for item in params.ItemsToModify:
            results.append(
                self._subscriptions.modify_item(
                    request.session, params.SubscriptionId, item, params.TimestampsToReturn
                )
            )
            await request.turn.breathe()
        return ua.ModifyMonitoredItemsResponse(Results=results)

    async def _delete_items(
        self, request: Request, params: ua.DeleteMonitoredItemsParameters
    ) -> ua.DeleteMonitoredItemsResponse:
        self._check_count(params.MonitoredItemIds)
        codes = []
        for item in params.MonitoredItemIds:
            code = self._subscriptions.delete_item(request.session, params.SubscriptionId, item)
            codes.append(code)
            await request.turn.breathe()
        return ua.DeleteMonitoredItemsResponse(Results=_statuses(codes))

    async def _set_monitoring_mode(
        self, request: Request, params: ua.SetMonitoringModeParameters
    ) -> ua.SetMonitoringModeResponse:
        self._check_count(params.MonitoredItemIds)
        codes = []
        for item in params.MonitoredItemIds:
            codes.append(
                self._subscriptions.set_monitoring(
                    request.session, params.SubscriptionId, item, params.MonitoringMode
                )
            )
            await request.turn.breathe()
        response = ua.SetMonitoringModeResponse()
        response.Parameters.Results = _statuses(codes)
        return response

    async def _set_triggering(
        self, request: Request, params: ua.SetTriggeringParameters
    ) -> ua.SetTriggeringResponse:
        links = [*(params.LinksToAdd or ()), *(params.LinksToRemove or ())]
        self._check_count(links)
        session, subscriptions = request.session, self._subscriptions
        where = params.SubscriptionId, params.TriggeringItemId
        result = ua.SetTriggeringResult()
        for linked in params.LinksToRemove or ():
            code = subscriptions.unlink(session, *where, linked)
            result.RemoveResults.append(ua.StatusCode(code))
            await request.turn.breathe()
        for linked in params.LinksToAdd or ():
            code = subscriptions.link(session, *where, linked)
            result.AddResults.append(ua.StatusCode(code))
            await request.turn.breathe()
        return ua.SetTriggeringResponse(Parameters=result)

    async def _cancel(self, request: Request, params: ua.CancelParameters) -> ua.CancelResponse:
        # All but Publish are answered before the next request is read.
        count = request.session.cancel(params.RequestHandle)
        self._audit.cancelled(request.actor, params.RequestHandle)
        response = ua.CancelResponse()
        response.Parameters.CancelCount = count
        return response

    def _check_count(self, operations: Sequence[Any] | None, most: int | None = None) -> None:
        if not operations:
            raise ServiceError(_Codes.BadNothingToDo)
        if len(operations) > (self._limits.operations if most is None else most):
            raise ServiceError(_Codes.BadTooManyOperations)

    def _ticks(self) -> int:
        return ticks_of_ns(self._clock.now())


def _statuses(codes: Sequence[int]) -> list[ua.StatusCode]:
    return [ua.StatusCode(code) for code in codes]


def _name(session: Session) -> str:
    return "" if session.principal is None else session.principal.name
