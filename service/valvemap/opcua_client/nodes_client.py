"""A client for our own servers, results or rig: connect, browse and read.

It uses standard services only and does not need the compiled decoding loops of the source client.
"""

from collections.abc import Sequence

from asyncua import ua

from valvemap.errors import SourceLost
from valvemap.opcua_client.connection import Connection, open_connection
from valvemap.opcua_client.followed import Followed
from valvemap.opcua_client.requests import (
    children_of,
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
from valvemap.opcua_client.source_settings import SourceSettings

UNKNOWN_NODE = int(ua.StatusCodes.BadNodeIdUnknown)  # code of a reading: no such variable


class NodesClient:
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

    async def permitted(self, ids: Sequence[str]) -> list[bool]:
        """Whether the user may write each of these variables, or call each of these methods.

        Raises
        ------
        SourceLost, SourceRejected
        """
        wanted = (ua.AttributeIds.UserAccessLevel, ua.AttributeIds.UserExecutable)
        answers = await self._attributes(ids, wanted, "reading the user's rights")
        return [is_permitted(level, executable) for level, executable in answers]

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
