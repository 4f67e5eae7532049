"""The services of a session: each request is checked, answered and counted (Part 4, 5)."""

from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.address_space.attributes import Attributes
from guarded_opcua.address_space.browse import View
from guarded_opcua.audit import Audit
from guarded_opcua.clock import Clock
from guarded_opcua.conditions.calls import Conditions
from guarded_opcua.history.reading import Histories
from guarded_opcua.sessions.attribute_services import AttributeServices
from guarded_opcua.sessions.item_services import ItemServices
from guarded_opcua.sessions.method_services import MethodServices
from guarded_opcua.sessions.operations import Operations
from guarded_opcua.sessions.requests import Handler, Request
from guarded_opcua.sessions.subscription_services import SubscriptionServices
from guarded_opcua.sessions.view_services import ViewServices
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.registry import Subscriptions

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds


class Services:
    """Answers the requests of active sessions, each by its service set."""

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
        self._audit = audit
        operations = Operations(limits, clock)
        self._handlers: dict[int, tuple[type, Handler]] = {
            **AttributeServices(operations, limits, attributes, histories, audit).handlers,
            **MethodServices(
                operations, limits, attributes, conditions, subscriptions, audit
            ).handlers,
            **ViewServices(operations, view).handlers,
            **SubscriptionServices(operations, limits, clock, subscriptions).handlers,
            **ItemServices(operations, subscriptions).handlers,
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

    async def _cancel(self, request: Request, params: ua.CancelParameters) -> ua.CancelResponse:
        # All but Publish are answered before the next request is read.
        count = request.session.queue.cancel(params.RequestHandle)
        self._audit.cancelled(request.actor, params.RequestHandle)
        response = ua.CancelResponse()
        response.Parameters.CancelCount = count
        return response
