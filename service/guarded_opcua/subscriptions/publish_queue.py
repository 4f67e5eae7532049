"""The publish requests of one session, and the order of its subscriptions."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from asyncua import ua

from guarded_opcua.binary.encoding import encode_message, encode_status_change, ticks_of_ns
from guarded_opcua.clock import Clock
from guarded_opcua.subscriptions.pace import Pace
from guarded_opcua.subscriptions.subscription import Message, Subscription


@dataclass(frozen=True)
class PublishRequest:
    """A queued publish request."""

    request_id: int
    handle: int
    results: tuple[int, ...]
    deadline: float


Answer = Callable[[PublishRequest, int, Message], None]
Refuse = Callable[[PublishRequest, int], None]


class PublishQueue:
    """Publish requests in order of arrival; late subscriptions by priority, then by age.

    Parameters
    ----------
    capacity
        Maximum number of requests; above it the oldest is answered BadTooManyPublishRequests.
    answer, refuse
        Answer a request with a message or a fault.
    ready
        Returns whether the connection is ready to send.
    clock
        Clock of the deadlines and publish times.
    pace
        Limits the processor time of publishing.
    """

    def __init__(
        self,
        capacity: int,
        answer: Answer,
        refuse: Refuse,
        ready: Callable[[], bool],
        clock: Clock,
        pace: Pace,
    ) -> None:
        self._capacity = capacity
        self._answer = answer
        self._refuse = refuse
        self._ready = ready
        self._clock = clock
        self._pace = pace
        self._requests: deque[PublishRequest] = deque()
        self._late: dict[int, Subscription] = {}

    def __len__(self) -> int:
        return len(self._requests)

    def add(self, request: PublishRequest) -> None:
        """Queue a request; answer it immediately if a subscription is late."""
        while len(self._requests) >= self._capacity:
            self._refuse(self._requests.popleft(), ua.StatusCodes.BadTooManyPublishRequests)
        self._requests.append(request)
        self.serve()

    def publish(self, subscription: Subscription) -> None:
        """Send a subscription's messages while requests are queued, then mark it as late."""
        if subscription.waiting_since is None:
            subscription.waiting_since = self._clock.monotonic()
        self._late[subscription.number] = subscription
        self.serve()

    def serve(self) -> None:
        """Serve the late subscriptions while requests are queued, in time slices."""
        for subscription in sorted(
            self._late.values(), key=lambda s: (-s.timing.priority, s.waiting_since or 0.0)
        ):
            while subscription.has_message():
                if not self._requests or not self._ready():
                    return
                if not self._pace.may_go_on():
                    self._pace.later(self.serve)
                    return
                request = self._requests.popleft()
                self._answer(request, subscription.number, subscription.next_message())
            self.forget(subscription)

    def forget(self, subscription: Subscription) -> None:
        """Remove a subscription from the late ones."""
        subscription.waiting_since = None
        self._late.pop(subscription.number, None)

    def notify(self, number: int, code: int) -> None:
        """Send a StatusChangeNotification for a subscription if a request is queued."""
        if self._requests and self._ready():
            content = encode_message(
                1, ticks_of_ns(self._clock.now()), [encode_status_change(code)]
            )
            self._answer(self._requests.popleft(), number, Message(1, content, (), more=False))

    def drop_expired(self) -> None:
        """Answer the expired requests with BadTimeout."""
        now = self._clock.monotonic()
        expired = [request for request in self._requests if request.deadline <= now]
        for request in expired:
            self._requests.remove(request)
            self._refuse(request, ua.StatusCodes.BadTimeout)

    def cancel(self, handle: int) -> int:
        """Cancel the requests with this handle; return their number."""
        cancelled = [request for request in self._requests if request.handle == handle]
        for request in cancelled:
            self._requests.remove(request)
            self._refuse(request, ua.StatusCodes.BadRequestCancelledByClient)
        return len(cancelled)

    def refuse_all(self, code: int) -> None:
        """Answer all requests with a fault."""
        while self._requests:
            self._refuse(self._requests.popleft(), code)

    def lose_connection(self) -> None:
        """Drop the requests of a lost connection."""
        self._requests.clear()
