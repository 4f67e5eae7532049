"""A client for our own servers, results or rig, that follows, calls, writes and reads history."""

from collections.abc import Collection, Sequence
from typing import Any

from asyncua import ua

from valvemap.errors import CommandRejected
from valvemap.opcua_client.condition_events import (
    ConditionChange,
    condition_filter,
    condition_of,
)
from valvemap.opcua_client.followed import Followed
from valvemap.opcua_client.history_reads import Course, read_aggregates, read_events
from valvemap.opcua_client.nodes_client import NodesClient
from valvemap.opcua_client.requests import in_chunks
from valvemap.opcua_client.result_readings import Reading, reading
from valvemap.opcua_client.sampling import CLOSELY, Sampling
from valvemap.opcua_client.source_errors import status_name

_NO_HISTORY = (
    ua.uaerrors.BadHistoryOperationUnsupported,
    ua.uaerrors.BadServiceUnsupported,
    ua.uaerrors.BadNotSupported,
    ua.uaerrors.BadUserAccessDenied,
)
_METHODS_AT_ONCE = 50  # calls per request, so that other requests are not blocked
_LATE = 10  # queue size of a watched variable, for delayed publishing


class ResultsClient(NodesClient):
    """`NodesClient` with subscriptions, alarms, method calls, writes and history."""

    async def follow(self, ids: Collection[str], every_s: float) -> None:
        """Subscribe to exactly these variables, published every ``every_s``; none: unsubscribe.

        An equal value with a new timestamp is a change.

        Raises
        ------
        SourceRejected
            if the server accepts no more items or subscriptions; none are monitored then.
        SourceLost
        """
        await self._follow(ids, every_s, CLOSELY)

    async def watch(self, ids: Collection[str], every_s: float) -> None:
        """Like :meth:`follow`, but sampled every ``every_s``: intermediate values may be skipped.

        An equal value with a new timestamp is no change.

        Raises
        ------
        SourceRejected
            if the server accepts no more items or subscriptions; none are monitored then.
        SourceLost
        """
        await self._follow(ids, every_s, Sampling(every_s, _LATE, equal_too=False))

    def changes(self) -> list[tuple[str, Reading]]:
        """Return the changes received since the last call, in order of arrival.

        Raises
        ------
        SourceLost, SourceRejected
        """
        return [(id_, reading(value)) for id_, value in self._subscriptions().take()]

    @property
    def lost(self) -> int:
        """Changes dropped on this connection because they were not fetched in time."""
        return 0 if self._followed is None else self._followed.lost

    async def call(
        self, owner: str, method: str, inputs: Sequence[Sequence[float | str]]
    ) -> list[tuple[Any, ...]]:
        """Call ``method`` of ``owner`` once for each of the ``inputs``; return each call's outputs.

        Raises
        ------
        CommandRejected
            if the server rejects a call; the message has the StatusCode.
        SourceLost, SourceRejected
        """
        connection = self._connected()
        requests = [
            ua.CallMethodRequest(
                ObjectId=self._node(owner),
                MethodId=self._node(f"{owner}.{method}"),
                InputArguments=[_variant(value) for value in arguments],
            )
            for arguments in inputs
        ]
        with connection.errors(f"calling {owner}.{method}"):
            results = await in_chunks(
                requests, _METHODS_AT_ONCE, lambda chunk: connection.session.call(list(chunk))
            )
        for result in results:
            _check(f"{owner}.{method}", result.StatusCode.value)
        return [
            tuple(output.Value for output in result.OutputArguments or ()) for result in results
        ]

    async def write(self, id: str, value: float) -> None:  # noqa: A002 - OPC UA's word
        """Write a Double.

        Raises
        ------
        CommandRejected
            if the server rejects the value; the message has the StatusCode.
        SourceLost, SourceRejected
        """
        connection = self._connected()
        written = ua.DataValue(ua.Variant(float(value), ua.VariantType.Double), StatusCode=None)
        with connection.errors(f"writing {id}"):
            (status,) = await connection.session.write(
                ua.WriteParameters(
                    NodesToWrite=[
                        ua.WriteValue(
                            NodeId=self._node(id), AttributeId=ua.AttributeIds.Value, Value=written
                        )
                    ]
                )
            )
        _check(id, status.value)

    async def courses(
        self, asked: Sequence[tuple[str, str]], span: tuple[int, int], every_ns: int
    ) -> list[Course]:
        """Read aggregates of variables from the server's history, at equal intervals.

        ``asked`` are identifiers with Average, Minimum or Maximum; ``span`` in UTC ns, its end
        excluded. A variable without a history has a Bad ``code``.

        Raises
        ------
        CommandRejected
            if the server reads no history.
        SourceLost, SourceRejected
        """
        connection = self._connected()
        nodes = [(self._node(id_), kind) for id_, kind in asked]
        with connection.errors("reading history"):
            try:
                return await read_aggregates(connection, nodes, span, every_ns)
            except _NO_HISTORY as error:
                raise CommandRejected(f"{self.url}: keeps no history ({error})") from None

    async def past_conditions(self, span: tuple[int, int], most: int) -> list[ConditionChange]:
        """Return the newest changes of all alarms in a span (UTC ns), the newest first.

        Raises
        ------
        CommandRejected
            if the server keeps no history of events.
        SourceLost, SourceRejected
        """
        connection, server = self._connected(), ua.NodeId(ua.ObjectIds.Server)
        with connection.errors("reading past alarms"):
            try:
                found = await read_events(connection, server, condition_filter(), span, most)
            except _NO_HISTORY as error:
                raise CommandRejected(f"{self.url}: keeps no past alarms ({error})") from None
        return [change for values in found if (change := condition_of(values)) is not None]

    async def listen(self, every_s: float) -> None:
        """Subscribe to the changes of all alarms; those that wait for an operator come first.

        Raises
        ------
        SourceRejected
            if the server accepts no more subscriptions or items.
        SourceLost
        """
        followed, connection = self._subscriptions(), self._connected()
        server = ua.NodeId(ua.ObjectIds.Server)
        number = await followed.listen(server, condition_filter(), every_s)
        refresh = ua.CallMethodRequest(
            ObjectId=ua.NodeId(ua.ObjectIds.ConditionType),
            MethodId=ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh),
            InputArguments=[ua.Variant(number, ua.VariantType.UInt32)],
        )
        with connection.errors("asking for the present alarms"):
            (result,) = await connection.session.call([refresh])
        _check("ConditionRefresh", result.StatusCode.value)

    def conditions(self) -> list[ConditionChange]:
        """Return the changes of alarms received since the last call, in order of arrival.

        Raises
        ------
        SourceLost, SourceRejected
        """
        found = map(condition_of, self._subscriptions().take_events())
        return [change for change in found if change is not None]

    async def comment(self, condition: str, event: bytes, text: str) -> None:
        """Add a comment to a condition, of which ``event`` is an EventId.

        Raises
        ------
        CommandRejected
            if the server rejects it; the message has the StatusCode.
        SourceLost, SourceRejected
        """
        connection = self._connected()
        request = ua.CallMethodRequest(
            ObjectId=self._node(condition),
            MethodId=ua.NodeId(ua.ObjectIds.ConditionType_AddComment),
            InputArguments=[ua.Variant(event), ua.Variant(ua.LocalizedText(text))],
        )
        with connection.errors(f"commenting on {condition}"):
            (result,) = await connection.session.call([request])
        _check(f"{condition}.AddComment", result.StatusCode.value)

    async def _follow(self, ids: Collection[str], every_s: float, sampling: Sampling) -> None:
        await self._subscriptions().follow({id_: self._node(id_) for id_ in ids}, every_s, sampling)

    def _subscriptions(self) -> Followed[str]:
        if self._followed is None:
            raise self._not_connected()
        return self._followed


def _variant(value: float | str) -> ua.Variant:
    if isinstance(value, str):
        return ua.Variant(value, ua.VariantType.String)
    return ua.Variant(float(value), ua.VariantType.Double)


def _check(what: str, code: int) -> None:
    if code >> 30:
        raise CommandRejected(f"{what}: refused by the server, {status_name(code)}")
