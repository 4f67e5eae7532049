"""The subscription service set: create, publish, republish, transfer (Part 4, 5.13)."""

import asyncio

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.binary.encoding import (
    encode_republish_response,
    encode_status,
    encode_structure,
)
from guarded_opcua.clock import Clock
from guarded_opcua.sessions.operations import Operations, refusal
from guarded_opcua.sessions.requests import Handlers, Request
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.publish_queue import PublishRequest
from guarded_opcua.subscriptions.registry import Subscriptions

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_refused_transfer = refusal(ua.TransferResult)


class SubscriptionServices:
    """Answers the services of subscriptions; a publish request is queued and answered later."""

    def __init__(
        self, operations: Operations, limits: Limits, clock: Clock, subscriptions: Subscriptions
    ) -> None:
        self._operations = operations
        self._limits = limits
        self._clock = clock
        self._subscriptions = subscriptions
        self.handlers: Handlers = {
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
        }

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
        async def delete(number: int) -> bytes:
            return encode_status(self._subscriptions.delete(request.session, number))

        kind = _Ids.DeleteSubscriptionsResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.SubscriptionIds, delete, encode_status
        )

    async def _set_publishing_mode(
        self, request: Request, params: ua.SetPublishingModeParameters
    ) -> bytes:
        enabled = bool(params.PublishingEnabled)

        async def switch(number: int) -> bytes:
            session = request.session
            return encode_status(
                self._subscriptions.set_publishing(session, number, enabled=enabled)
            )

        kind = _Ids.SetPublishingModeResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.SubscriptionIds, switch, encode_status
        )

    async def _transfer_subscriptions(
        self, request: Request, params: ua.TransferSubscriptionsParameters
    ) -> bytes:
        session, send_values = request.session, bool(params.SendInitialValues)

        async def transfer(number: int) -> bytes:
            result = await self._subscriptions.transfer(
                session, number, request.turn.breathe, send_values=send_values
            )
            return encode_structure(result)

        kind = _Ids.TransferSubscriptionsResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.SubscriptionIds, transfer, _refused_transfer
        )

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
        return encode_republish_response(request.handle, self._operations.ticks(), content)
