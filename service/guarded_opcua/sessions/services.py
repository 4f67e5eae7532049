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
    encode_history_result,
    encode_or_refuse,
    encode_republish_response,
    encode_results,
    encode_status,
    encode_structure,
    ticks_of_ns,
)
from guarded_opcua.caller import acting_for
from guarded_opcua.clock import Clock
from guarded_opcua.conditions.calls import Conditions
from guarded_opcua.history.reading import Histories
from guarded_opcua.sessions.operations import answer_each
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
    """The scheduled turn of the running request."""

    async def breathe(self) -> None:
        """Yield to other connections if this request has used its time slice."""

    async def outside(self, slow: Awaitable[T]) -> T:
        """Await a slow operation with the turn released."""


@dataclass(frozen=True)
class Request:
    """One request of an active session."""

    session: Session
    request_id: int
    header: ua.RequestHeader
    turn: Turn

    @property
    def handle(self) -> int:
        """RequestHandle, the client's number of the request."""
        return int(self.header.RequestHandle)

    @property
    def actor(self) -> Actor:
        """The client that sent the request."""
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
        """Return a response, its encoded form, or None if the request is answered later.

        Raises
        ------
        ServiceError
            with the status code of the fault.
        """
        return await self._handlers[service][1](request, params)

    async def _read(self, request: Request, params: ua.ReadParameters) -> bytes:
        if params.MaxAge < 0:
            raise ServiceError(_Codes.BadMaxAgeInvalid)
        if params.TimestampsToReturn not in tuple(ua.TimestampsToReturn)[:4]:
            raise ServiceError(_Codes.BadTimestampsToReturnInvalid)
        self._check_count(params.NodesToRead)
        role, stamps = request.session.role, params.TimestampsToReturn

        async def read(wanted: ua.ReadValueId) -> bytes:
            return encode_or_refuse(self._attributes.read(wanted, role), stamps)

        values = await self._each(request, params.NodesToRead, read, _refused_value)
        return self._results(request, _Ids.ReadResponse_Encoding_DefaultBinary, values)

    async def _write(self, request: Request, params: ua.WriteParameters) -> bytes:
        self._check_count(params.NodesToWrite)
        role = request.session.role

        async def write(item: ua.WriteValue) -> bytes:
            before, code = self._attributes.held(item), _Codes.BadInternalError
            try:
                with acting_for(_name(request.session)):
                    code = await self._attributes.write(item, role, request.turn.outside)
            finally:
                self._audit.written(request.actor, item, before, code)
            return encode_status(code)

        codes = await self._each(request, params.NodesToWrite, write, encode_status)
        return self._results(request, _Ids.WriteResponse_Encoding_DefaultBinary, codes)

    async def _call(self, request: Request, params: ua.CallParameters) -> bytes:
        self._check_count(params.MethodsToCall, self._limits.method_calls)

        async def call(wanted: ua.CallMethodRequest) -> bytes:
            code = _Codes.BadInternalError
            try:
                result = await self._call_one(request, wanted)
                encoded = encode_structure(result)
                code = result.StatusCode.value
            finally:
                self._audit.called(request.actor, wanted, code)
            return encoded

        results = await self._each(request, params.MethodsToCall, call, _refused_call)
        return self._results(request, _Ids.CallResponse_Encoding_DefaultBinary, results)

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
        rests = request.session.rests

        async def read(number: int) -> bytes:
            if params.ReleaseContinuationPoints:
                return self._histories.release(params.NodesToRead[number], rests)
            return await self._histories.read(params, number, rests, request.turn)

        numbers = range(len(params.NodesToRead))
        results = await self._each(request, numbers, read, encode_history_result)
        return self._results(request, _Ids.HistoryReadResponse_Encoding_DefaultBinary, results)

    async def _browse(self, request: Request, params: ua.BrowseParameters) -> bytes:
        self._check_count(params.NodesToBrowse)
        continuations = request.session.continuations

        async def browse(wanted: ua.BrowseDescription) -> bytes:
            return encode_structure(self._view.browse(params, wanted, continuations))

        results = await self._each(request, params.NodesToBrowse, browse, _refused_browse)
        return self._results(request, _Ids.BrowseResponse_Encoding_DefaultBinary, results)

    async def _browse_next(self, request: Request, params: ua.BrowseNextParameters) -> bytes:
        self._check_count(params.ContinuationPoints)
        continuations, release = request.session.continuations, params.ReleaseContinuationPoints

        async def browse(point: bytes) -> bytes:
            result = self._view.browse_next(point, continuations, release=bool(release))
            return encode_structure(result)

        results = await self._each(request, params.ContinuationPoints, browse, _refused_browse)
        return self._results(request, _Ids.BrowseNextResponse_Encoding_DefaultBinary, results)

    async def _translate(
        self, request: Request, params: ua.TranslateBrowsePathsToNodeIdsParameters
    ) -> bytes:
        self._check_count(params.BrowsePaths)

        async def follow(path: ua.BrowsePath) -> bytes:
            return encode_structure(await self._view.translate(path, request.turn.breathe))

        results = await self._each(request, params.BrowsePaths, follow, _refused_path)
        kind = _Ids.TranslateBrowsePathsToNodeIdsResponse_Encoding_DefaultBinary
        return self._results(request, kind, results)

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
    ) -> bytes:
        self._check_count(params.SubscriptionIds)

        async def delete(number: int) -> bytes:
            return encode_status(self._subscriptions.delete(request.session, number))

        codes = await self._each(request, params.SubscriptionIds, delete, encode_status)
        kind = _Ids.DeleteSubscriptionsResponse_Encoding_DefaultBinary
        return self._results(request, kind, codes)

    async def _set_publishing_mode(
        self, request: Request, params: ua.SetPublishingModeParameters
    ) -> bytes:
        self._check_count(params.SubscriptionIds)
        enabled = bool(params.PublishingEnabled)

        async def switch(number: int) -> bytes:
            session = request.session
            return encode_status(
                self._subscriptions.set_publishing(session, number, enabled=enabled)
            )

        codes = await self._each(request, params.SubscriptionIds, switch, encode_status)
        return self._results(request, _Ids.SetPublishingModeResponse_Encoding_DefaultBinary, codes)

    async def _transfer_subscriptions(
        self, request: Request, params: ua.TransferSubscriptionsParameters
    ) -> bytes:
        self._check_count(params.SubscriptionIds)
        session, send_values = request.session, bool(params.SendInitialValues)

        async def transfer(number: int) -> bytes:
            result = await self._subscriptions.transfer(
                session, number, request.turn.breathe, send_values=send_values
            )
            return encode_structure(result)

        results = await self._each(request, params.SubscriptionIds, transfer, _refused_transfer)
        kind = _Ids.TransferSubscriptionsResponse_Encoding_DefaultBinary
        return self._results(request, kind, results)

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
    ) -> bytes:
        self._check_count(params.ItemsToCreate)
        number, stamps = params.SubscriptionId, params.TimestampsToReturn

        async def create(item: ua.MonitoredItemCreateRequest) -> bytes:
            return encode_structure(
                self._subscriptions.create_item(request.session, number, item, stamps)
            )

        results = await self._each(request, params.ItemsToCreate, create, _refused_item)
        kind = _Ids.CreateMonitoredItemsResponse_Encoding_DefaultBinary
        return self._results(request, kind, results)

    async def _modify_items(
        self, request: Request, params: ua.ModifyMonitoredItemsParameters
    ) -> bytes:
        self._check_count(params.ItemsToModify)
        number, stamps = params.SubscriptionId, params.TimestampsToReturn

        async def modify(item: ua.MonitoredItemModifyRequest) -> bytes:
            return encode_structure(
                self._subscriptions.modify_item(request.session, number, item, stamps)
            )

        results = await self._each(request, params.ItemsToModify, modify, _refused_change)
        kind = _Ids.ModifyMonitoredItemsResponse_Encoding_DefaultBinary
        return self._results(request, kind, results)

    async def _delete_items(
        self, request: Request, params: ua.DeleteMonitoredItemsParameters
    ) -> bytes:
        self._check_count(params.MonitoredItemIds)
        session, number = request.session, params.SubscriptionId

        async def delete(item: int) -> bytes:
            return encode_status(self._subscriptions.delete_item(session, number, item))

        codes = await self._each(request, params.MonitoredItemIds, delete, encode_status)
        kind = _Ids.DeleteMonitoredItemsResponse_Encoding_DefaultBinary
        return self._results(request, kind, codes)

    async def _set_monitoring_mode(
        self, request: Request, params: ua.SetMonitoringModeParameters
    ) -> bytes:
        self._check_count(params.MonitoredItemIds)
        session, number, mode = request.session, params.SubscriptionId, params.MonitoringMode

        async def switch(item: int) -> bytes:
            return encode_status(self._subscriptions.set_monitoring(session, number, item, mode))

        codes = await self._each(request, params.MonitoredItemIds, switch, encode_status)
        return self._results(request, _Ids.SetMonitoringModeResponse_Encoding_DefaultBinary, codes)

    async def _set_triggering(self, request: Request, params: ua.SetTriggeringParameters) -> bytes:
        add, remove = list(params.LinksToAdd or ()), list(params.LinksToRemove or ())
        self._check_count([*add, *remove])
        session, subscriptions = request.session, self._subscriptions
        where = params.SubscriptionId, params.TriggeringItemId

        async def unlink(linked: int) -> bytes:
            return encode_status(subscriptions.unlink(session, *where, linked))

        async def link(linked: int) -> bytes:
            return encode_status(subscriptions.link(session, *where, linked))

        removed = await self._each(request, remove, unlink, encode_status)
        added = await self._each(request, add, link, encode_status)
        kind = _Ids.SetTriggeringResponse_Encoding_DefaultBinary
        return self._results(request, kind, added, removed)

    async def _cancel(self, request: Request, params: ua.CancelParameters) -> ua.CancelResponse:
        # All but Publish are answered before the next request is read.
        count = request.session.queue.cancel(params.RequestHandle)
        self._audit.cancelled(request.actor, params.RequestHandle)
        response = ua.CancelResponse()
        response.Parameters.CancelCount = count
        return response

    def _check_count(self, operations: Sequence[Any] | None, most: int | None = None) -> None:
        if not operations:
            raise ServiceError(_Codes.BadNothingToDo)
        if len(operations) > (self._limits.operations if most is None else most):
            raise ServiceError(_Codes.BadTooManyOperations)

    async def _each(
        self,
        request: Request,
        operations: Sequence[T],
        answer: Callable[[T], Awaitable[bytes]],
        refusal: Callable[[int], bytes],
    ) -> list[bytes]:
        most = self._limits.response_bytes
        return await answer_each(operations, answer, refusal, request.turn.breathe, most)

    def _results(self, request: Request, kind: int, *results: Sequence[bytes]) -> bytes:
        return encode_results(kind, request.handle, self._ticks(), *results)

    def _ticks(self) -> int:
        return ticks_of_ns(self._clock.now())


def _refusal(result: type) -> Callable[[int], bytes]:
    """Return an encoder of results of this type that hold only a status code."""
    return lambda code: encode_structure(result(StatusCode=ua.StatusCode(code)))


_refused_value = _refusal(ua.DataValue)
_refused_call = _refusal(ua.CallMethodResult)
_refused_browse = _refusal(ua.BrowseResult)
_refused_path = _refusal(ua.BrowsePathResult)
_refused_item = _refusal(ua.MonitoredItemCreateResult)
_refused_change = _refusal(ua.MonitoredItemModifyResult)
_refused_transfer = _refusal(ua.TransferResult)


def _name(session: Session) -> str:
    return "" if session.principal is None else session.principal.name
