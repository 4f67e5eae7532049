"""The method service set: Call, also for conditions and for the session (Part 4, 5.11)."""

from asyncua import ua

from guarded_opcua.address_space.attributes import Attributes
from guarded_opcua.audit import Audit
from guarded_opcua.binary.encoding import encode_structure
from guarded_opcua.caller import acting_for
from guarded_opcua.conditions.calls import Conditions
from guarded_opcua.sessions.operations import Operations, refusal
from guarded_opcua.sessions.requests import Handlers, Request
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.registry import Subscriptions

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_refused_call = refusal(ua.CallMethodResult)
_GET_MONITORED_ITEMS = ua.NodeId(_Ids.Server_GetMonitoredItems)
_RESEND_DATA = ua.NodeId(_Ids.Server_ResendData)


class MethodServices:
    """Answers Call."""

    def __init__(
        self,
        operations: Operations,
        limits: Limits,
        attributes: Attributes,
        conditions: Conditions,
        subscriptions: Subscriptions,
        audit: Audit,
    ) -> None:
        self._operations = operations
        self._limits = limits
        self._attributes = attributes
        self._conditions = conditions
        self._subscriptions = subscriptions
        self._audit = audit
        self.handlers: Handlers = {
            _Ids.CallRequest_Encoding_DefaultBinary: (ua.CallParameters, self._call),
        }

    async def _call(self, request: Request, params: ua.CallParameters) -> bytes:
        async def call(wanted: ua.CallMethodRequest) -> bytes:
            code = _Codes.BadInternalError
            try:
                result = await self._call_one(request, wanted)
                encoded = encode_structure(result)
                code = result.StatusCode.value
            finally:
                self._audit.called(request.actor, wanted, code)
            return encoded

        kind = _Ids.CallResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.MethodsToCall, call, _refused_call, most=self._limits.method_calls
        )

    async def _call_one(
        self, request: Request, wanted: ua.CallMethodRequest
    ) -> ua.CallMethodResult:
        session = request.session
        if wanted.MethodId in (_GET_MONITORED_ITEMS, _RESEND_DATA):
            return await self._call_for_session(request, wanted)
        with acting_for(session.user):
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
            await self._subscriptions.items.resend(session, number, request.turn.breathe)
        else:
            pairs = self._subscriptions.items.of(session, number)
            result.OutputArguments = [
                ua.Variant([pair[side] for pair in pairs], ua.VariantType.UInt32, is_array=True)
                for side in (0, 1)
            ]
        return result
