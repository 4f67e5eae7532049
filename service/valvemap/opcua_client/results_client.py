"""A client for our own servers, results or rig: browse, read, follow, call, write.

It uses standard services only and does not need the compiled decoding loops of the source client.
"""

from collections.abc import Collection, Sequence
from typing import Any

from asyncua import ua

from valvemap.errors import CommandRejected, SourceLost
from valvemap.opcua_client.condition_events import (
    ConditionChange,
    condition_filter,
    condition_of,
)
from valvemap.opcua_client.connection import Connection, open_connection
from valvemap.opcua_client.followed import CLOSELY, Followed, Sampling
from valvemap.opcua_client.history_reads import Course, read_aggregates, read_events
from valvemap.opcua_client.requests import (
    children_of,
    in_chunks,
    namespaces_of,
    read_attributes,
    read_properties,
    read_values,
)
from valvemap.opcua_client.result_readings import (
    Child,
    Engineering,
    Reading,
    engineering,
    is_permitted,
    reading,
    type_name,
)
from valvemap.opcua_client.source_errors import status_name
from valvemap.opcua_client.source_settings import Security, SourceSettings

__all__ = ["Child", "Engineering", "Reading", "ResultsClient", "Security", "SourceSettings"]

UNKNOWN_NODE = int(ua.StatusCodes.BadNodeIdUnknown)  # code of a reading: no such variable

_NO_HISTORY = (
    ua.uaerrors.BadHistoryOperationUnsupported,
    ua.uaerrors.BadServiceUnsupported,
    ua.uaerrors.BadNotSupported,
    ua.uaerrors.BadUserAccessDenied,
)
_METHODS_AT_ONCE = 50  # calls per request, so that other requests are not blocked
_LATE = 10  # queue size of a watched variable, for delayed publishing


class ResultsClient:
    """Nodes of one server, identified by their string identifiers in one namespace.

    Parameters
    ----------
    settings
        Server, security, user.
    namespace
        URI of the namespace of the identifiers.
    """

    def __init__(self, settings: SourceSettings, namespace: str) -> None:
        self._settings = settings
        self._namespace = namespace
        self._connection: Connection | None = None
        self._followed: Followed[str] | None = None
        self._index = 0

    @property
    def url(self) -> str:
        """The endpoint URL of the server."""
        return self._settings.url

    async def connect(self) -> None:
        """Connect and log in.

        Raises
        ------
        SourceLost
            if the server cannot be reached; a retry may succeed.
        SourceRejected
            if it rejects the certificate or the user.
        CertificateError
            if our own certificate or key cannot be used.
        """
        await self.close()
        connection = await open_connection(self._settings)
        try:
            self._index = await self._find_namespace(connection)
        except BaseException:
            await connection.close()
            raise
        self._connection, self._followed = connection, Followed(connection)

    async def close(self) -> None:
        """Disconnect; safe to call twice, and after a loss."""
        connection, self._connection = self._connection, None
        followed, self._followed = self._followed, None
        if connection is not None:
            await connection.close()
        if followed is not None:
            await followed.end()

    async def browse(self, id: str | None) -> list[Child]:  # noqa: A002 - OPC UA's word
        """Return the children of a node in our namespace; None is the Objects folder.

        Raises
        ------
        SourceLost, SourceRejected
        """
        (children,) = await self.browse_each([id])
        return children

    async def browse_each(self, ids: Sequence[str | None]) -> list[list[Child]]:
        """Return the children of several nodes, in few requests; see :meth:`browse`.

        Raises
        ------
        SourceLost, SourceRejected
        """
        connection = self._connected()
        objects = ua.NodeId(ua.ObjectIds.ObjectsFolder)
        nodes = [objects if id_ is None else self._node(id_) for id_ in ids]
        with connection.errors(f"browsing {ids[0] or 'Objects'}"):
            found = await children_of(connection, nodes)
        return [
            [
                Child(
                    str(reference.NodeId.Identifier),
                    reference.NodeClass == ua.NodeClass.Variable,
                    reference.NodeClass == ua.NodeClass.Method,
                )
                for reference in references
                if reference.NodeId.NamespaceIndex == self._index
            ]
            for references in found
        ]

    async def scalar_types(self, ids: Sequence[str]) -> list[str | None]:
        """Return the names of variables' built-in types; None for arrays and structures.

        An enumeration of the servers' own is an Int32.

        Raises
        ------
        SourceLost, SourceRejected
        """
        wanted = (ua.AttributeIds.DataType, ua.AttributeIds.ValueRank)
        answers = await self._attributes(ids, wanted, "reading types")
        return [type_name(kind, rank, self._index) for kind, rank in answers]

    async def engineering(self, ids: Sequence[str]) -> list[Engineering]:
        """Return units, ranges and descriptions of variables.

        Raises
        ------
        SourceLost, SourceRejected
        """
        connection = self._connected()
        nodes = [self._node(id_) for id_ in ids]
        with connection.errors("reading units"):
            pairs = await read_properties(connection, nodes, ("EngineeringUnits", "EURange"))
            texts = await read_attributes(connection, nodes, (ua.AttributeIds.Description,))
        return [
            engineering(information, span, text)
            for (information, span), (text,) in zip(pairs, texts, strict=True)
        ]

    async def read(self, ids: Sequence[str | int]) -> list[Reading]:
        """Read variables, one reading each; a variable that cannot be read has a Bad ``code``.

        An integer is a numeric identifier in namespace 0.

        Raises
        ------
        SourceLost, SourceRejected
        """
        connection = self._connected()
        nodes = [self._node(id_) for id_ in ids]
        with connection.errors("reading"):
            answers = await read_values(connection, nodes, ua.TimestampsToReturn.Source)
        return [reading(answer) for answer in answers]

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
        if self._followed is None:
            raise self._not_connected()
        return [(id_, reading(value)) for id_, value in self._followed.take()]

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

    async def permitted(self, ids: Sequence[str]) -> list[bool]:
        """Whether the user may write each of these variables, or call each of these methods.

        Raises
        ------
        SourceLost, SourceRejected
        """
        wanted = (ua.AttributeIds.UserAccessLevel, ua.AttributeIds.UserExecutable)
        answers = await self._attributes(ids, wanted, "reading the user's rights")
        return [is_permitted(level, executable) for level, executable in answers]

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
        if self._followed is None:
            raise self._not_connected()
        connection, server = self._connected(), ua.NodeId(ua.ObjectIds.Server)
        number = await self._followed.listen(server, condition_filter(), every_s)
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
        if self._followed is None:
            raise self._not_connected()
        found = map(condition_of, self._followed.take_events())
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
        if self._followed is None:
            raise self._not_connected()
        await self._followed.follow({id_: self._node(id_) for id_ in ids}, every_s, sampling)

    async def _find_namespace(self, connection: Connection) -> int:
        namespaces = await namespaces_of(connection)
        if self._namespace not in namespaces:
            raise SourceLost(f"{self.url}: has no namespace {self._namespace} (yet)")
        return namespaces.index(self._namespace)

    def _connected(self) -> Connection:
        if self._connection is None:
            raise self._not_connected()
        return self._connection

    def _not_connected(self) -> SourceLost:
        return SourceLost(f"{self.url}: not connected")

    async def _attributes(
        self, ids: Sequence[str], wanted: Sequence[ua.AttributeIds], doing: str
    ) -> list[list[ua.DataValue]]:
        connection = self._connected()
        with connection.errors(doing):
            return await read_attributes(connection, [self._node(id_) for id_ in ids], wanted)

    def _node(self, id_: str | int) -> ua.NodeId:
        return ua.NodeId(id_, self._index if isinstance(id_, str) else 0)


def _variant(value: float | str) -> ua.Variant:
    if isinstance(value, str):
        return ua.Variant(value, ua.VariantType.String)
    return ua.Variant(float(value), ua.VariantType.Double)


def _check(what: str, code: int) -> None:
    if code >> 30:
        raise CommandRejected(f"{what}: refused by the server, {status_name(code)}")
