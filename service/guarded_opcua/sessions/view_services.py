"""The view service set: Browse, translate paths, register nodes (Part 4, 5.8)."""

from asyncua import ua

from guarded_opcua.address_space.browse import View
from guarded_opcua.binary.encoding import encode_structure
from guarded_opcua.sessions.operations import Operations, refusal
from guarded_opcua.sessions.requests import Handlers, Request

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_refused_browse = refusal(ua.BrowseResult)
_refused_path = refusal(ua.BrowsePathResult)


class ViewServices:
    """Answers the services by which clients find nodes."""

    def __init__(self, operations: Operations, view: View) -> None:
        self._operations = operations
        self._view = view
        self.handlers: Handlers = {
            _Ids.BrowseRequest_Encoding_DefaultBinary: (ua.BrowseParameters, self._browse),
            _Ids.BrowseNextRequest_Encoding_DefaultBinary: (
                ua.BrowseNextParameters,
                self._browse_next,
            ),
            _Ids.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary: (
                ua.TranslateBrowsePathsToNodeIdsParameters,
                self._translate,
            ),
            _Ids.RegisterNodesRequest_Encoding_DefaultBinary: (
                ua.RegisterNodesParameters,
                self._register_nodes,
            ),
            _Ids.UnregisterNodesRequest_Encoding_DefaultBinary: (
                ua.UnregisterNodesParameters,
                self._unregister_nodes,
            ),
        }

    async def _browse(self, request: Request, params: ua.BrowseParameters) -> bytes:
        continuations = request.session.continuations

        async def browse(wanted: ua.BrowseDescription) -> bytes:
            return encode_structure(self._view.browse(params, wanted, continuations))

        kind = _Ids.BrowseResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.NodesToBrowse, browse, _refused_browse
        )

    async def _browse_next(self, request: Request, params: ua.BrowseNextParameters) -> bytes:
        continuations, release = request.session.continuations, params.ReleaseContinuationPoints

        async def browse(point: bytes) -> bytes:
            result = self._view.browse_next(point, continuations, release=bool(release))
            return encode_structure(result)

        kind = _Ids.BrowseNextResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.ContinuationPoints, browse, _refused_browse
        )

    async def _translate(
        self, request: Request, params: ua.TranslateBrowsePathsToNodeIdsParameters
    ) -> bytes:
        async def follow(path: ua.BrowsePath) -> bytes:
            return encode_structure(await self._view.translate(path, request.turn.breathe))

        kind = _Ids.TranslateBrowsePathsToNodeIdsResponse_Encoding_DefaultBinary
        return await self._operations.answer(
            request, kind, params.BrowsePaths, follow, _refused_path
        )

    async def _register_nodes(
        self, _: Request, params: ua.RegisterNodesParameters
    ) -> ua.RegisterNodesResponse:
        self._operations.check_count(params.NodesToRegister)
        response = ua.RegisterNodesResponse()
        response.Parameters.RegisteredNodeIds = params.NodesToRegister
        return response

    async def _unregister_nodes(
        self, _: Request, params: ua.UnregisterNodesParameters
    ) -> ua.UnregisterNodesResponse:
        self._operations.check_count(params.NodesToUnregister)
        return ua.UnregisterNodesResponse()
