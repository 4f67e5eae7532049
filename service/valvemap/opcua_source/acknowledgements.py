"""Which messages of a subscription are acknowledged to the server."""

from collections import deque
from collections.abc import Iterable

from asyncua import ua

_MOST_KEPT_BACK = 10_000  # messages; more than a server retains


class Acknowledgements:
    """Acknowledges every received message, or after `hold_back` only committed ones.

    Attributes
    ----------
    unsent
        To be sent with the next publish request.
    """

    def __init__(self, subscription: int) -> None:
        self.unsent: list[ua.SubscriptionAcknowledgement] = []
        self._subscription = subscription
        self._kept_back: deque[int] | None = None  # messages not committed yet

    @property
    def kept_back(self) -> tuple[int, ...] | None:
        """Sequence numbers of messages that are not committed; None: commits are not awaited."""
        return None if self._kept_back is None else tuple(self._kept_back)

    @property
    def known(self) -> set[int]:
        """Sequence numbers that are acknowledged next, or kept back."""
        return {one.SequenceNumber for one in self.unsent} | set(self._kept_back or ())

    def continue_from(
        self,
        unsent: Iterable[ua.SubscriptionAcknowledgement],
        kept_back: Iterable[int] | None,
    ) -> None:
        """Start from what a previous connection did not send."""
        self.unsent = list(unsent)
        if kept_back is not None:
            self._kept_back = deque(kept_back, _MOST_KEPT_BACK)

    def hold_back(self) -> None:
        """Acknowledge from now on only committed messages."""
        self._kept_back = deque(maxlen=_MOST_KEPT_BACK)

    def add(self, number: int) -> None:
        """Acknowledge a received message, now or after its commit."""
        if self._kept_back is not None:
            self._kept_back.append(number)
        else:
            self._send(number)

    def commit(self, subscription: int, message: int) -> None:
        """Acknowledge all messages of a subscription up to ``message``."""
        if self._kept_back is None or subscription != self._subscription:
            return
        while self._kept_back and (message - self._kept_back[0]) % 2**32 < 2**31:
            self._send(self._kept_back.popleft())

    def take(self) -> list[ua.SubscriptionAcknowledgement]:
        """Return those to send now."""
        unsent, self.unsent = self.unsent, []
        return unsent

    def _send(self, number: int) -> None:
        self.unsent.append(
            ua.SubscriptionAcknowledgement(SubscriptionId=self._subscription, SequenceNumber=number)
        )
