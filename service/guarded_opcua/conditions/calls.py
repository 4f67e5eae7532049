"""Methods of conditions: acknowledge, confirm, comment, refresh (Part 9, 5.5 to 5.7)."""

import secrets
from collections.abc import Sequence
from typing import Protocol

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.address_space.method_calls import Outside, rejection_code
from guarded_opcua.binary.encoding import instant
from guarded_opcua.clock import Clock
from guarded_opcua.conditions.condition import Condition
from guarded_opcua.conditions.keeper import ConditionKeeper
from guarded_opcua.conditions.nodes import METHODS, ConditionNodes
from guarded_opcua.conditions.refresh import Refresh
from guarded_opcua.errors import CommandRejected
from guarded_opcua.logs import bounded_logger
from guarded_opcua.monitoring.events import Event
from guarded_opcua.security.accounts import Role
from guarded_opcua.subscriptions.registry import Subscriptions
from guarded_opcua.subscriptions.subscription import Owner

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_Types = ua.VariantType
_CONDITION_TYPE = ua.NodeId(_Ids.ConditionType)
_REFRESH = ua.NodeId(_Ids.ConditionType_ConditionRefresh)
_REFRESH_2 = ua.NodeId(_Ids.ConditionType_ConditionRefresh2)
_SERVER = ua.NodeId(_Ids.Server)
_REFRESH_SEVERITY = 100

REFRESHES = (_REFRESH, _REFRESH_2)
_MOVES = tuple(METHODS.values())
_GIVEN = {  # input argument types of each method
    METHODS["AddComment"]: (_Types.ByteString, _Types.LocalizedText),
    METHODS["Acknowledge"]: (_Types.ByteString, _Types.LocalizedText),
    METHODS["Confirm"]: (_Types.ByteString, _Types.LocalizedText),
    _REFRESH: (_Types.UInt32,),
    _REFRESH_2: (_Types.UInt32, _Types.UInt32),
}


class Asking(Owner, Protocol):
    """The calling session."""

    @property
    def role(self) -> Role:
        """Role of the logged-in user."""


class Conditions:
    """Serves conditions to clients: an event per change, ConditionRefresh, methods."""

    def __init__(self, subscriptions: Subscriptions, nodes: ConditionNodes, clock: Clock) -> None:
        self.keeper: ConditionKeeper | None = None
        self.nodes = nodes
        self._subscriptions = subscriptions
        self._clock = clock
        self._refreshing: set[int] = set()  # SubscriptionIds

    def report(self, condition: Condition) -> None:
        """Emit an event for a changed condition if it is monitored; update its nodes if any."""
        events = self._subscriptions.events
        if events.has_audience(condition.key.emitters, Role.OBSERVER):
            events.trigger(condition.event())
        self.nodes.show(condition)

    def is_call(self, wanted: ua.CallMethodRequest) -> bool:
        """Return whether a call is a method of a condition."""
        return self.keeper is not None and (
            wanted.MethodId in _MOVES or wanted.MethodId in REFRESHES
        )

    async def call(
        self, session: Asking, wanted: ua.CallMethodRequest, outside: Outside
    ) -> ua.CallMethodResult:
        """Execute a call; slow operations are awaited by ``outside``."""
        given = wanted.InputArguments or []
        expected = _GIVEN[wanted.MethodId]
        if len(given) != len(expected):
            few = len(given) < len(expected)
            return _result(_Codes.BadArgumentsMissing if few else _Codes.BadTooManyArguments)
        found = [
            _Codes.Good if _fits(argument, kind) else _Codes.BadTypeMismatch
            for argument, kind in zip(given, expected, strict=True)
        ]
        if any(found):
            return _result(_Codes.BadInvalidArgument, found)
        values = [argument.Value for argument in given]
        if wanted.MethodId in REFRESHES:
            code = self._refresh(session, wanted.ObjectId, values)
        else:
            code = await self._move(session, wanted, outside, *values)
        return _result(code, found if code == _Codes.Good else ())

    async def _move(
        self,
        session: Asking,
        wanted: ua.CallMethodRequest,
        outside: Outside,
        event_id: bytes | None,
        comment: ua.LocalizedText | None,
    ) -> int:
        keeper, id_ = self.keeper, wanted.ObjectId
        condition = keeper.find(id_) if keeper is not None else None
        if keeper is None or condition is None:
            return _Codes.BadNodeIdUnknown
        if session.role < Role.OPERATOR:
            return _Codes.BadUserAccessDenied
        if not condition.is_told_by(event_id):
            return _Codes.BadEventIdUnknown
        if wanted.MethodId == METHODS["Acknowledge"]:
            act, done, code = keeper.acknowledge, condition.acked, _ALREADY_ACKED
        elif wanted.MethodId == METHODS["Confirm"]:
            act, done, code = keeper.confirm, condition.confirmed, _ALREADY_CONFIRMED
        else:
            act, done, code = keeper.remark, False, _Codes.Good
        if done:
            return code
        try:
            outcome = act(id_, (comment.Text or "") if comment is not None else "")
            if outcome is not None:
                await outside(outcome)
        except CommandRejected as rejected:
            _log.warning("%s: refused: %s", id_.Identifier, rejected)
            return rejection_code(rejected)
        return _Codes.Good

    def _refresh(self, session: Asking, owner: ua.NodeId, numbers: Sequence[int]) -> int:
        if owner != _CONDITION_TYPE and (self.keeper is None or self.keeper.find(owner) is None):
            return _Codes.BadMethodInvalid
        number = numbers[0]
        if number not in session.subscriptions:
            known = number in self._subscriptions.by_number
            return _Codes.BadUserAccessDenied if known else _Codes.BadSubscriptionIdInvalid
        if number in self._refreshing:
            return _Codes.BadRefreshInProgress
        try:
            items = self._subscriptions.items.event_items(session, *numbers)
        except ServiceError as error:
            return int(error.code)
        marks = (
            self._mark(_Ids.RefreshStartEventType, "Refresh begins."),
            self._mark(_Ids.RefreshEndEventType, "Refresh ends."),
        )
        subscription = session.subscriptions[number]
        assert self.keeper is not None  # noqa: S101 - see is_call
        self._refreshing.add(number)
        refresh = Refresh(self._subscriptions, subscription, items, marks, self.keeper, self._clock)
        refresh.begin(lambda: self._refreshing.discard(number))
        return _Codes.Good

    def _mark(self, kind: int, said: str) -> Event:
        now = instant(self._clock.now())
        fields = {
            "EventId": ua.Variant(secrets.token_bytes(16), _Types.ByteString),
            "EventType": ua.Variant(ua.NodeId(kind), _Types.NodeId),
            "SourceNode": ua.Variant(_SERVER, _Types.NodeId),
            "SourceName": ua.Variant("Server", _Types.String),
            "Time": ua.Variant(now, _Types.DateTime),
            "ReceiveTime": ua.Variant(now, _Types.DateTime),
            "Message": ua.Variant(ua.LocalizedText(said, "en"), _Types.LocalizedText),
            "Severity": ua.Variant(_REFRESH_SEVERITY, _Types.UInt16),
        }
        return Event((_SERVER,), ua.NodeId(kind), fields)


_ALREADY_ACKED = _Codes.BadConditionBranchAlreadyAcked
_ALREADY_CONFIRMED = _Codes.BadConditionBranchAlreadyConfirmed


def _fits(given: ua.Variant, kind: ua.VariantType) -> bool:
    is_null = given.VariantType == _Types.Null and kind != _Types.UInt32
    return is_null or (given.VariantType == kind and not given.is_array)


def _result(code: int, of_arguments: Sequence[int] = ()) -> ua.CallMethodResult:
    found = ua.CallMethodResult(StatusCode=ua.StatusCode(code))
    found.InputArgumentResults = [ua.StatusCode(each) for each in of_arguments]
    return found
