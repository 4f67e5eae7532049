"""The Server object: capabilities, limits, status, diagnostics (Part 5, 6.3)."""

import asyncio
import datetime as dt
from collections.abc import Callable, Iterable
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.insertion import reference
from guarded_opcua.binary.encoding import instant
from guarded_opcua.clock import Clock
from guarded_opcua.logs import bounded_logger
from guarded_opcua.settings import ServerSettings

_log = bounded_logger(__name__)
_Ids = ua.ObjectIds
_Types = ua.VariantType
_UINT32 = _Types.UInt32
_REFRESH_S = 1.0
_PROFILES = [
    "http://opcfoundation.org/UA-Profile/Server/EmbeddedUA2017",
    "http://opcfoundation.org/UA-Profile/Server/Methods",
    "http://opcfoundation.org/UA-Profile/Server/DataAccess",
    "http://opcfoundation.org/UA-Profile/Server/StandardEventSubscription",
]
_PROFILES_OF_HISTORY = [
    "http://opcfoundation.org/UA-Profile/Server/HistoricalRawData",
    "http://opcfoundation.org/UA-Profile/Server/HistoricalDataAtTime",
    "http://opcfoundation.org/UA-Profile/Server/AggregateHistorical",
]
_PROFILE_OF_PAST_EVENTS = "http://opcfoundation.org/UA-Profile/Server/BaseHistoricalEvent"
_PROFILES_OF_CONDITIONS = [
    "http://opcfoundation.org/UA-Profile/Server/ACBaseCondition",
    "http://opcfoundation.org/UA-Profile/Server/ACRefresh2",
    "http://opcfoundation.org/UA-Profile/Server/ACAddressSpaceInstance",
    "http://opcfoundation.org/UA-Profile/Server/ACAlarm",
    "http://opcfoundation.org/UA-Profile/Server/ACAcknowledgeableAlarm",
    "http://opcfoundation.org/UA-Profile/Server/ACExclusiveAlarming",
]
_LIMIT_OF = {
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead: "operations",
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerWrite: "operations",
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerMethodCall: "method_calls",
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerBrowse: "operations",
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerRegisterNodes: "operations",
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerTranslateBrowsePathsToNodeIds: (
        "operations"
    ),
    _Ids.Server_ServerCapabilities_OperationLimits_MaxMonitoredItemsPerCall: "operations",
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerHistoryReadData: "history_reads",
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerHistoryReadEvents: "history_reads",
    _Ids.Server_ServerCapabilities_MaxArrayLength: "array_length",
    _Ids.Server_ServerCapabilities_MaxStringLength: "string_bytes",
    _Ids.Server_ServerCapabilities_MaxByteStringLength: "string_bytes",
    _Ids.Server_ServerCapabilities_MaxSessions: "sessions",
    _Ids.Server_ServerCapabilities_MaxSubscriptions: "subscriptions",
    _Ids.Server_ServerCapabilities_MaxMonitoredItems: "monitored_items",
    _Ids.Server_ServerCapabilities_MaxSubscriptionsPerSession: "subscriptions_per_session",
    _Ids.Server_ServerCapabilities_MaxMonitoredItemsPerSubscription: (
        "monitored_items_per_subscription"
    ),
    _Ids.Server_ServerCapabilities_MaxMonitoredItemsQueueSize: "queue_size",
}
# not supported; set to 1, since 0 would mean "no limit"
_NOT_OFFERED = (
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerHistoryUpdateData,
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerHistoryUpdateEvents,
    _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerNodeManagement,
)
_NO_HISTORY_SERVICES = (
    _Ids.HistoryServerCapabilities_DeleteAtTimeCapability,
    _Ids.HistoryServerCapabilities_DeleteEventCapability,
    _Ids.HistoryServerCapabilities_DeleteRawCapability,
    _Ids.HistoryServerCapabilities_InsertAnnotationCapability,
    _Ids.HistoryServerCapabilities_InsertDataCapability,
    _Ids.HistoryServerCapabilities_InsertEventCapability,
    _Ids.HistoryServerCapabilities_ReplaceDataCapability,
    _Ids.HistoryServerCapabilities_ReplaceEventCapability,
    _Ids.HistoryServerCapabilities_UpdateDataCapability,
    _Ids.HistoryServerCapabilities_UpdateEventCapability,
)
_NOT_DIAGNOSED = (
    _Ids.Server_ServerDiagnostics_SubscriptionDiagnosticsArray,
    _Ids.Server_ServerDiagnostics_SamplingIntervalDiagnosticsArray,
    _Ids.Server_ServerDiagnostics_SessionsDiagnosticsSummary_SessionDiagnosticsArray,
    _Ids.Server_ServerDiagnostics_SessionsDiagnosticsSummary_SessionSecurityDiagnosticsArray,
)
_SUMMARY = {
    "CurrentSessionCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_CurrentSessionCount
    ),
    "CumulatedSessionCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_CumulatedSessionCount
    ),
    "SecurityRejectedSessionCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_SecurityRejectedSessionCount
    ),
    "RejectedSessionCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_RejectedSessionCount
    ),
    "SessionTimeoutCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_SessionTimeoutCount
    ),
    "PublishingIntervalCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_PublishingIntervalCount
    ),
    "CurrentSubscriptionCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_CurrentSubscriptionCount
    ),
    "CumulatedSubscriptionCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_CumulatedSubscriptionCount
    ),
    "SecurityRejectedRequestsCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_SecurityRejectedRequestsCount
    ),
    "RejectedRequestsCount": (
        _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_RejectedRequestsCount
    ),
}

Write = Callable[[ua.NodeId, ua.DataValue], None]
Summary = Callable[[], dict[str, int]]


class SelfDescription:
    """Updates the standard nodes of the Server object."""

    def __init__(
        self,
        aspace: AddressSpace,
        write: Write,
        clock: Clock,
        settings: ServerSettings,
        summary: Summary,
    ) -> None:
        self._aspace = aspace
        self._write = write
        self._clock = clock
        self._settings = settings
        self._summary = summary
        self._started = 0
        self._task: asyncio.Task[None] | None = None

    def announce(
        self, aggregates: Iterable[int] | None, *, conditions: bool, past_events: int
    ) -> None:
        """Write the nodes that do not change while the server runs.

        ``aggregates`` are the supported aggregates, None without HistoryRead of values.
        ``conditions``: whether there are conditions. ``past_events`` is the maximum number of
        events per HistoryRead response, 0 without event history.
        """
        settings, limits = self._settings, self._settings.limits
        for node, name in _LIMIT_OF.items():
            self._set(node, getattr(limits, name), _UINT32)
        for node in _NOT_OFFERED:
            self._set(node, 1, _UINT32)
        points = limits.continuation_points
        self._set(_Ids.Server_ServerCapabilities_MaxBrowseContinuationPoints, points, _Types.UInt16)
        self._set(_Ids.Server_ServerCapabilities_MaxQueryContinuationPoints, 0, _Types.UInt16)
        points = limits.history_continuation_points
        self._set(
            _Ids.Server_ServerCapabilities_MaxHistoryContinuationPoints, points, _Types.UInt16
        )
        self._set(
            _Ids.HistoryServerCapabilities_MaxReturnDataValues, limits.history_values, _UINT32
        )
        self._set(_Ids.HistoryServerCapabilities_MaxReturnEventValues, past_events or 1, _UINT32)
        for node in _NO_HISTORY_SERVICES:
            self._set(node, False, _Types.Boolean)  # noqa: FBT003 - a value
        for node, there in (
            (_Ids.HistoryServerCapabilities_AccessHistoryDataCapability, aggregates is not None),
            (_Ids.HistoryServerCapabilities_AccessHistoryEventsCapability, past_events > 0),
            (_Ids.HistoryServerCapabilities_ServerTimestampSupported, True),
        ):
            self._set(node, there, _Types.Boolean)
        self._show_aggregates(aggregates or ())
        self._set(
            _Ids.Server_ServerCapabilities_MinSupportedSampleRate,
            limits.publishing_interval_ms,
            _Types.Double,
        )
        profiles = [
            *_PROFILES,
            *(_PROFILES_OF_HISTORY if aggregates is not None else ()),
            *([_PROFILE_OF_PAST_EVENTS] if past_events else ()),
            *(_PROFILES_OF_CONDITIONS if conditions else ()),
        ]
        self._set(_Ids.Server_ServerCapabilities_ServerProfileArray, profiles, _Types.String)
        self._set(_Ids.Server_ServerCapabilities_LocaleIdArray, ["en"], _Types.String)
        self._set(_Ids.Server_ServerArray, [settings.application_uri], _Types.String)
        self._set(_Ids.Server_ServiceLevel, 255, _Types.Byte)
        self._set(_Ids.Server_Auditing, True, _Types.Boolean)  # noqa: FBT003 - a value
        self._set(_Ids.Server_ServerDiagnostics_EnabledFlag, True, _Types.Boolean)  # noqa: FBT003
        self._set(
            _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary_ServerViewCount, 0, _UINT32
        )

    def _show_aggregates(self, aggregates: Iterable[int]) -> None:
        """Add the supported aggregates to the AggregateFunctions folders."""
        for folder in (
            _Ids.HistoryServerCapabilities_AggregateFunctions,
            _Ids.Server_ServerCapabilities_AggregateFunctions,
        ):
            shown = self._aspace[ua.NodeId(folder)].references
            for aggregate in aggregates:
                function = self._aspace[ua.NodeId(int(aggregate))]
                shown.append(reference(ua.NodeId(_Ids.Organizes), function, forward=True))

        not_supported = ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadNotSupported))
        for node in _NOT_DIAGNOSED:
            self._write(ua.NodeId(node), not_supported)

    def start(self) -> None:
        """Set the state to Running, and start updating the current time."""
        self._started = self._clock.now()
        self._set(_Ids.Server_ServerStatus_State, ua.ServerState.Running, _Types.Int32)
        self._set(_Ids.Server_ServerStatus_StartTime, instant(self._started), _Types.DateTime)
        build = self._build_info()
        self._set(_Ids.Server_ServerStatus_BuildInfo, build, _Types.ExtensionObject)
        for name in ("ProductUri", "ManufacturerName", "ProductName", "SoftwareVersion"):
            node = getattr(_Ids, f"Server_ServerStatus_BuildInfo_{name}")
            self._set(node, getattr(build, name), _Types.String)
        self._set(_Ids.Server_ServerStatus_BuildInfo_BuildNumber, build.BuildNumber, _Types.String)
        self._set(_Ids.Server_ServerStatus_BuildInfo_BuildDate, build.BuildDate, _Types.DateTime)
        self._refresh()
        self._task = asyncio.create_task(self._refresh_for_ever())

    def stop(self) -> None:
        """Stop updating the current time."""
        if self._task is not None:
            self._task.cancel()

    def set_service_level(self, level: int) -> None:
        """Set the ServiceLevel: 255 healthy, 0 out of service."""
        self._set(_Ids.Server_ServiceLevel, level, _Types.Byte)

    async def _refresh_for_ever(self) -> None:
        while True:
            await self._clock.sleep(_REFRESH_S)
            self._refresh()

    def _refresh(self) -> None:
        now = self._clock.now()
        status = ua.ServerStatusDataType(
            StartTime=instant(self._started),
            CurrentTime=instant(now),
            State=ua.ServerState.Running,
            BuildInfo=self._build_info(),
        )
        self._set(_Ids.Server_ServerStatus, status, _Types.ExtensionObject)
        self._set(_Ids.Server_ServerStatus_CurrentTime, instant(now), _Types.DateTime)
        counts = self._summary()
        summary = ua.ServerDiagnosticsSummaryDataType()
        for name, node in _SUMMARY.items():
            setattr(summary, name, counts[name])
            self._set(node, counts[name], _UINT32)
        node = _Ids.Server_ServerDiagnostics_ServerDiagnosticsSummary
        self._set(node, summary, _Types.ExtensionObject)

    def _build_info(self) -> ua.BuildInfo:
        return ua.BuildInfo(
            ProductUri=self._settings.product.uri,
            ManufacturerName=self._settings.product.manufacturer,
            ProductName=self._settings.application_name,
            SoftwareVersion=self._settings.product.version,
            BuildNumber="",
            BuildDate=dt.datetime(2025, 1, 1, tzinfo=dt.UTC),
        )

    def _set(self, node: int, value: Any, kind: ua.VariantType) -> None:  # noqa: ANN401
        nodeid = ua.NodeId(node)
        if nodeid not in self._aspace:
            return
        now = instant(self._clock.now())
        variant = ua.Variant(value, kind)
        self._write(nodeid, ua.DataValue(variant, ua.StatusCode(), now, now))
