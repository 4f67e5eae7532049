"""A session that checks ownership, roles and limits before it lets asyncua act."""

import inspect
import logging
import secrets
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_session import InternalSession
from typing_extensions import override

from service.errors import CommandRejected
from service.opcua.hardened import nodes
from service.opcua.hardened.users import Role

if TYPE_CHECKING:
    from service.opcua.hardened.internal import GuardedInternalServer

_log = logging.getLogger(__name__)
_audit = logging.getLogger("valvemap.audit")
_Codes = ua.StatusCodes


@dataclass
class Principal(User):
    """Who acts, and in which role of ours; never asyncua's Admin, who may write everything."""

    role: UserRole = UserRole.User
    name: str | None = None
    level: Role = Role.OBSERVER

    def __str__(self) -> str:
        return f"{self.name or 'anonymous'} ({self.level.name.lower()})"


class GuardedSession(InternalSession):
    """A session of a peer: only its own subscriptions, only what its role allows."""

    iserver: "GuardedInternalServer"

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - asyncua's signature
        super().__init__(*args, **kwargs)
        self.peer_certificate: bytes | None = None
        self.peer: str = str(self.name)
        self.session_id = ua.NodeId(secrets.randbits(31) | 1, 1)
        if self.external:
            self.iserver.unregister_external_session(self)
            token = secrets.token_bytes(32)
            self.auth_token = ua.NodeId(token, 0, ua.NodeIdType.ByteString)
            self.iserver.register_external_session(self)

    @property
    def level(self) -> Role:
        """The role of who is logged in."""
        return self.user.level if isinstance(self.user, Principal) else Role.SECURITY_ADMIN

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        """Read; what depends on the user is answered for this user."""
        found = await super().read(params)
        if not self.external:
            return found
        return [
            self._for_this_user(wanted, value)
            for wanted, value in zip(params.NodesToRead, found, strict=True)
        ]

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Write values of variables that are writable for this user; nothing else."""
        if not self.external:
            return await super().write(params)
        return [ua.StatusCode(await self._write(item)) for item in params.NodesToWrite]

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Call methods that this user may call."""
        return [await self._call(request) for request in params]

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription within the limits; its intervals are revised truthfully."""
        if self.external:
            limits = self.iserver.limits
            if len(self._own_subscriptions()) >= limits.subscriptions_per_session:
                raise ServiceError(_Codes.BadTooManySubscriptions)
            requested = params.RequestedPublishingInterval
            if not requested >= limits.publishing_interval_ms:  # NaN too
                requested = limits.publishing_interval_ms
            params.RequestedPublishingInterval = min(
                requested, limits.longest_publishing_interval_ms
            )
        return await super().create_subscription(params, callback, request_callback)

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Create monitored items in a subscription of this session."""
        self._check_owner(params.SubscriptionId)
        return await super().create_monitored_items(params)

    async def modify_monitored_items(
        self, params: ua.ModifyMonitoredItemsParameters
    ) -> list[ua.MonitoredItemModifyResult]:
        """Modify monitored items in a subscription of this session."""
        self._check_owner(params.SubscriptionId)
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(
        self, params: ua.DeleteMonitoredItemsParameters
    ) -> list[ua.StatusCode]:
        """Delete monitored items in a subscription of this session."""
        self._check_owner(params.SubscriptionId)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(
        self, params: ua.SetMonitoringModeParameters
    ) -> list[ua.StatusCode]:
        """Set the monitoring mode in a subscription of this session."""
        self._check_owner(params.SubscriptionId)
        return await super().set_monitoring_mode(params)

    async def set_publishing_mode(
        self, params: ua.SetPublishingModeParameters
    ) -> list[ua.StatusCode]:
        """Set the publishing mode of subscriptions of this session."""
        for number in params.SubscriptionIds:
            self._check_owner(number)
        return await super().set_publishing_mode(params)

    async def delete_subscriptions(self, ids: list[int]) -> list[ua.StatusCode]:
        """Delete subscriptions of this session."""
        for number in ids:
            self._check_owner(number)
        return await super().delete_subscriptions(ids)

    def modify_subscription(
        self, params: ua.ModifySubscriptionParameters
    ) -> ua.ModifySubscriptionResult:
        """Modify a subscription of this session."""
        self._check_owner(params.SubscriptionId)
        return super().modify_subscription(params)

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        """Send a message of a subscription of this session again."""
        self._check_owner(params.SubscriptionId)
        return super().republish(params)

    def publish(
        self, acks: Iterable[ua.SubscriptionAcknowledgement] | None = None
    ) -> tuple[int, list[ua.StatusCode]]:
        """Take acknowledgements for subscriptions of this session."""
        acks = list(acks or [])
        for ack in acks:
            self._check_owner(ack.SubscriptionId)
        return super().publish(acks)

    @override
    async def transfer_subscriptions(
        self, params: ua.TransferSubscriptionsParameters, callback: Callable[..., Any]
    ) -> list[ua.TransferResult]:
        """Refused until ownership can be proven."""
        raise ServiceError(_Codes.BadServiceUnsupported)

    def _own_subscriptions(self) -> list[Any]:
        return [
            subscription
            for subscription in self.subscription_service.subscriptions.values()
            if subscription.session_id == self.session_id
        ]

    def _check_owner(self, number: int) -> None:
        subscription = self.subscription_service.subscriptions.get(number)
        if self.external and subscription and subscription.session_id != self.session_id:
            raise ServiceError(_Codes.BadSubscriptionIdInvalid)

    def _for_this_user(self, wanted: ua.ReadValueId, value: ua.DataValue) -> ua.DataValue:
        if wanted.AttributeId == ua.AttributeIds.UserAccessLevel:
            variable = self.iserver.variables.get(wanted.NodeId)
            if variable and variable.writable_by and self.level < variable.writable_by:
                level = value.Value.Value & ~(1 << ua.AccessLevel.CurrentWrite)
                return ua.DataValue(ua.Variant(level, ua.VariantType.Byte))
        if wanted.AttributeId == ua.AttributeIds.UserExecutable:
            method = self.iserver.methods.get(wanted.NodeId)
            if method is not None:
                return ua.DataValue(ua.Variant(self.level >= method.required))
        return value

    async def _write(self, item: ua.WriteValue) -> int:
        code = await self._try_write(item)
        _audit.info(
            "write %s by %s at %s: %s",
            item.NodeId.to_string(),
            self.user,
            self.peer,
            ua.StatusCode(code).name,
        )
        return code

    async def _try_write(self, item: ua.WriteValue) -> int:  # noqa: PLR0911 - one per reason
        held = self.aspace.read_attribute_value(item.NodeId, item.AttributeId)
        if held.StatusCode.value in (_Codes.BadNodeIdUnknown, _Codes.BadAttributeIdInvalid):
            return int(held.StatusCode.value)
        variable = self.iserver.variables.get(item.NodeId)
        if item.AttributeId != ua.AttributeIds.Value or not variable or not variable.writable_by:
            return _Codes.BadNotWritable
        if self.level < variable.writable_by:
            return _Codes.BadUserAccessDenied
        if item.IndexRange or not item.Value.StatusCode.is_good():
            return _Codes.BadWriteNotSupported
        code = nodes.check(variable, item.Value.Value)
        if code != _Codes.Good:
            return code
        value = nodes.plain(item.Value.Value)
        try:
            if variable.on_write is not None:
                outcome = variable.on_write(value)
                if inspect.isawaitable(outcome):
                    await outcome
        except CommandRejected as error:
            _log.warning("%s: write refused: %s", item.NodeId.Identifier, error)
            return nodes.rejection_code(error)
        self.iserver.take_write(variable, value, item.Value.SourceTimestamp)
        return _Codes.Good

    async def _call(self, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        method = self.iserver.methods.get(request.MethodId)
        owner = self.aspace.get(request.ObjectId)
        result = ua.CallMethodResult()
        if owner is None or request.MethodId not in self.aspace:
            result.StatusCode = ua.StatusCode(_Codes.BadNodeIdUnknown)
        elif not any(ref.NodeId == request.MethodId and ref.IsForward for ref in owner.references):
            result.StatusCode = ua.StatusCode(_Codes.BadMethodInvalid)
        elif method is None:
            result.StatusCode = ua.StatusCode(_Codes.BadNotImplemented)
        elif self.level < method.required:
            result.StatusCode = ua.StatusCode(_Codes.BadUserAccessDenied)
        else:
            result = await nodes.call(method, request.InputArguments or [])
        _audit.info(
            "call %s by %s at %s: %s",
            request.MethodId.to_string(),
            self.user,
            self.peer,
            result.StatusCode.name,
        )
        return result
