"""The attribute service set: Read, Write, HistoryRead (Part 4, 5.10)."""

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.address_space.attributes import Attributes
from guarded_opcua.audit import Audit
from guarded_opcua.binary.encoding import (
    encode_history_result,
    encode_or_refuse,
    encode_status,
)
from guarded_opcua.caller import acting_for
from guarded_opcua.history.reading import Histories
from guarded_opcua.sessions.operations import Operations, refusal
from guarded_opcua.sessions.requests import Handlers, Request
from guarded_opcua.settings import Limits

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_refused_value = refusal(ua.DataValue)


class AttributeServices:
    """Answers Read, Write and HistoryRead."""

    def __init__(
        self,
        operations: Operations,
        limits: Limits,
        attributes: Attributes,
        histories: Histories,
        audit: Audit,
    ) -> None:
        self._operations = operations
        self._limits = limits
        self._attributes = attributes
        self._histories = histories
        self._audit = audit
        self.handlers: Handlers = {
            _Ids.ReadRequest_Encoding_DefaultBinary: (ua.ReadParameters, self._read),
            _Ids.WriteRequest_Encoding_DefaultBinary: (ua.WriteParameters, self._write),
            _Ids.HistoryReadRequest_Encoding_DefaultBinary: (
                ua.HistoryReadParameters,
                self._history_read,
            ),
        }

    async def _read(self, request: Request, params: ua.ReadParameters) -> bytes:
        if params.MaxAge < 0:
            raise ServiceError(_Codes.BadMaxAgeInvalid)
        if params.TimestampsToReturn not in tuple(ua.TimestampsToReturn)[:4]:
            raise ServiceError(_Codes.BadTimestampsToReturnInvalid)
        role, stamps = request.session.role, params.TimestampsToReturn

        async def read(wanted: ua.ReadValueId) -> bytes:
            return encode_or_refuse(self._attributes.read(wanted, role), stamps)

        kind = _Ids.ReadResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.NodesToRead, read, _refused_value
        )

    async def _write(self, request: Request, params: ua.WriteParameters) -> bytes:
        role = request.session.role

        async def write(item: ua.WriteValue) -> bytes:
            before, code = self._attributes.held(item), _Codes.BadInternalError
            try:
                with acting_for(request.session.user):
                    code = await self._attributes.write(item, role, request.turn.outside)
            finally:
                self._audit.written(request.actor, item, before, code)
            return encode_status(code)

        kind = _Ids.WriteResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.NodesToWrite, write, encode_status
        )

    async def _history_read(self, request: Request, params: ua.HistoryReadParameters) -> bytes:
        if params.TimestampsToReturn not in tuple(ua.TimestampsToReturn)[:3]:
            raise ServiceError(_Codes.BadTimestampsToReturnInvalid)
        self._operations.check_count(params.NodesToRead, self._limits.history_reads)
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
        results = await self._operations.each(request, numbers, read, encode_history_result)
        return self._operations.results(
            request, _Ids.HistoryReadResponse_Encoding_DefaultBinary, results
        )
