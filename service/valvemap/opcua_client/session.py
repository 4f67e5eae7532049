"""The session of our client: only the services it uses, each response decoded within a budget."""

from collections.abc import Callable
from typing import Any, TypeVar

from asyncua import ua
from asyncua.client.ua_session import SessionState, UaSession
from typing_extensions import override

from valvemap.opcua_client.responses import decode_response
from valvemap.opcua_client.transport import BoundedClient

_T = TypeVar("_T")


class BatchSession(UaSession):
    """A session that returns publish responses undecoded.

    :mod:`valvemap.opcua_source.subscription` decodes them. The other services of asyncua would
    decode without bounds, so they raise NotImplementedError.

    Private seams of asyncua: ``UaSession._send_request``, ``_set_state``, ``ensure_publish_loop``.
    """

    def __init__(self, client: BoundedClient, audit_entry: str = "") -> None:
        super().__init__(client)
        self._transport = client
        self._audit_entry = audit_entry

    async def request(self, request: object, *, timeout: float | None = None) -> bytes:  # noqa: ASYNC109 - asyncua's way
        """Send a request and return the response's body from its TypeId on."""
        return await self._transport.call(request, timeout=timeout)

    @override
    async def create_session(
        self, parameters: ua.CreateSessionParameters
    ) -> ua.CreateSessionResult:
        request = ua.CreateSessionRequest(Parameters=parameters)
        result = (await self._ask(request, ua.CreateSessionResponse)).Parameters
        self.restore_authentication_token(result.AuthenticationToken)
        self._set_state(SessionState.CREATED)
        return result

    @override
    async def activate_session(
        self, parameters: ua.ActivateSessionParameters
    ) -> ua.ActivateSessionResult:
        request = ua.ActivateSessionRequest(Parameters=parameters)
        request.RequestHeader.AuditEntryId = self._audit_entry
        result = (await self._ask(request, ua.ActivateSessionResponse)).Parameters
        self._set_state(SessionState.ACTIVATED)
        return result

    @override
    async def close_session(self, delete_subscriptions: bool) -> None:
        if self.state not in {SessionState.CREATED, SessionState.ACTIVATED}:
            return
        self._set_state(SessionState.CLOSING)
        request = ua.CloseSessionRequest(DeleteSubscriptions=delete_subscriptions)
        try:
            await self._ask(request, ua.CloseSessionResponse)
        finally:
            self._set_state(SessionState.CLOSED)

    @override
    async def read(self, parameters: ua.ReadParameters) -> list[ua.DataValue]:
        request = ua.ReadRequest(Parameters=parameters)
        return (await self._ask(request, ua.ReadResponse)).Results

    @override
    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        request = ua.WriteRequest(Parameters=params)
        return (await self._ask(request, ua.WriteResponse)).Results

    @override
    async def browse(self, parameters: ua.BrowseParameters) -> list[ua.BrowseResult]:
        request = ua.BrowseRequest(Parameters=parameters)
        return (await self._ask(request, ua.BrowseResponse)).Results

    @override
    async def browse_next(self, parameters: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        request = ua.BrowseNextRequest(Parameters=parameters)
        return (await self._ask(request, ua.BrowseNextResponse)).Parameters.Results

    @override
    async def call(self, methodstocall: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        parameters = ua.CallParameters(MethodsToCall=methodstocall)
        request = ua.CallRequest(Parameters=parameters)
        return (await self._ask(request, ua.CallResponse)).Results

    @override
    async def create_subscription(
        self, params: ua.CreateSubscriptionParameters, callback: Callable[..., Any] | None = None
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription; the caller sends its publish requests."""
        request = ua.CreateSubscriptionRequest(Parameters=params)
        return (await self._ask(request, ua.CreateSubscriptionResponse)).Parameters

    async def end_subscription(self, number: int) -> None:
        """Delete a subscription."""
        parameters = ua.DeleteSubscriptionsParameters([number])
        request = ua.DeleteSubscriptionsRequest(Parameters=parameters)
        (status,) = (await self._ask(request, ua.DeleteSubscriptionsResponse)).Results
        status.check()

    @override
    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        request = ua.CreateMonitoredItemsRequest(Parameters=params)
        return (await self._ask(request, ua.CreateMonitoredItemsResponse)).Results

    @override
    async def translate_browsepaths_to_nodeids(
        self, browse_paths: list[ua.BrowsePath]
    ) -> list[ua.BrowsePathResult]:
        request = ua.TranslateBrowsePathsToNodeIdsRequest()
        request.Parameters.BrowsePaths = browse_paths
        return (await self._ask(request, ua.TranslateBrowsePathsToNodeIdsResponse)).Results

    async def resume(self, token: ua.NodeId) -> None:
        """Resume a session of another connection; it must be activated next."""
        self.restore_authentication_token(token)
        self._set_state(SessionState.CREATED)

    @override
    async def transfer_subscriptions(
        self, params: ua.TransferSubscriptionsParameters
    ) -> list[ua.TransferResult]:
        request = ua.TransferSubscriptionsRequest(Parameters=params)
        response = await self._ask(request, ua.TransferSubscriptionsResponse)
        return response.Parameters.Results

    @override
    async def modify_monitored_items(
        self, params: ua.ModifyMonitoredItemsParameters
    ) -> list[ua.MonitoredItemModifyResult]:
        request = ua.ModifyMonitoredItemsRequest(Parameters=params)
        return (await self._ask(request, ua.ModifyMonitoredItemsResponse)).Results

    @override
    async def delete_monitored_items(
        self, parameters: ua.DeleteMonitoredItemsParameters
    ) -> list[ua.StatusCode]:
        request = ua.DeleteMonitoredItemsRequest(Parameters=parameters)
        return (await self._ask(request, ua.DeleteMonitoredItemsResponse)).Results

    async def _ask(self, request: object, kind: type[_T]) -> _T:
        return decode_response(kind, await self.request(request))

    @override
    async def _send_request(self, request: object, *_: object, **__: object) -> None:
        raise NotImplementedError(f"{type(request).__name__}: its answer would be read unbounded")
