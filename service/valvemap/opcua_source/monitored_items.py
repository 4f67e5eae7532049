"""The monitored items of a subscription: create, check, enlarge queues, delete."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from asyncua import ua

from valvemap.errors import SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import in_chunks, operation_limits
from valvemap.opcua_client.source_errors import status_name
from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.elements import of_one_variable
from valvemap.vocabulary.signals import PER_VALVE

_log = logging.getLogger(__name__)

_ITEMS_AT_ONCE = 20 * PER_VALVE  # between two requests the server publishes


@dataclass(frozen=True)
class Item:
    """A monitored item: its node, its id at the server and the revised queue size.

    ``handle`` is the client handle of its changes; ``sampling_ms`` the revised sampling interval
    (0: unknown). Parts of one variable share id and handle.
    """

    node: MonitoredNode
    number: int
    queue_size: int
    handle: int
    sampling_ms: float = 0.0


async def create_items(
    connection: Connection, subscription: int, nodes: Mapping[int, MonitoredNode]
) -> tuple[Item, ...]:
    """Monitor every sample of every node; the keys are the client handles.

    Parts of one variable are one monitored item at the server, under the handle of the first.

    Raises
    ------
    SourceRejected
        if a node cannot be monitored; names it.
    UaError
    """
    settings = connection.settings
    handles = {node.item: handle for handle, node in nodes.items()}
    groups = of_one_variable(nodes.values())

    async def create(
        chunk: Sequence[Sequence[MonitoredNode]],
    ) -> list[ua.MonitoredItemCreateResult]:
        return await connection.session.create_monitored_items(
            ua.CreateMonitoredItemsParameters(
                SubscriptionId=subscription,
                TimestampsToReturn=ua.TimestampsToReturn.Both,
                ItemsToCreate=[
                    ua.MonitoredItemCreateRequest(
                        ItemToMonitor=ua.ReadValueId(
                            NodeId=own[0].node,
                            AttributeId=ua.AttributeIds.Value,
                            IndexRange=own[0].index_range if len(own) == 1 else None,
                        ),
                        MonitoringMode=ua.MonitoringMode.Reporting,
                        RequestedParameters=_parameters(
                            handles[own[0].item], connection, settings.queue_size
                        ),
                    )
                    for own in chunk
                ],
            )
        )

    limit = (await operation_limits(connection)).items_per_call
    created = await in_chunks(groups, min(limit, _ITEMS_AT_ONCE), create)
    for own, result in zip(groups, created, strict=True):
        if result.StatusCode.value >> 30:
            raise SourceRejected(
                f"{own[0].label} cannot be subscribed to at {settings.url}: "
                f"{status_name(result.StatusCode.value)}"
            )
    slowest_ms = max(result.RevisedSamplingInterval for result in created)
    if slowest_ms > max(settings.sampling_interval_ms, 0.0):
        _log.warning(
            "%s: samples a node every %g ms instead of %g ms",
            settings.url,
            slowest_ms,
            settings.sampling_interval_ms,
        )
    items = tuple(
        Item(
            node,
            result.MonitoredItemId,
            result.RevisedQueueSize,
            handles[own[0].item],
            result.RevisedSamplingInterval,
        )
        for own, result in zip(groups, created, strict=True)
        for node in own
    )
    _check_queues(connection, items, settings.queue_size)
    return items


async def delete_items(connection: Connection, subscription: int, numbers: Sequence[int]) -> None:
    """Delete the given monitored items.

    Raises
    ------
    UaError
    """

    async def delete(chunk: Sequence[int]) -> list[ua.StatusCode]:
        return await connection.session.delete_monitored_items(
            ua.DeleteMonitoredItemsParameters(subscription, list(chunk))
        )

    limit = (await operation_limits(connection)).items_per_call
    await in_chunks(list(dict.fromkeys(numbers)), min(limit, _ITEMS_AT_ONCE), delete)


async def enlarge_queues(
    connection: Connection, subscription: int, items: Sequence[Item], size: int
) -> tuple[Item, ...]:
    """Request queues of ``size`` values; return the items with their revised queue sizes.

    Raises
    ------
    UaError
    """

    async def modify(chunk: Sequence[Item]) -> list[ua.MonitoredItemModifyResult]:
        return await connection.session.modify_monitored_items(
            ua.ModifyMonitoredItemsParameters(
                SubscriptionId=subscription,
                TimestampsToReturn=ua.TimestampsToReturn.Both,
                ItemsToModify=[
                    ua.MonitoredItemModifyRequest(
                        item.number, _parameters(item.handle, connection, size)
                    )
                    for item in chunk
                ],
            )
        )

    limit = (await operation_limits(connection)).items_per_call
    by_number = {item.number: item for item in items}
    results = await in_chunks(list(by_number.values()), min(limit, _ITEMS_AT_ONCE), modify)
    sizes = {
        number: result.RevisedQueueSize
        for number, result in zip(by_number, results, strict=True)
        if not result.StatusCode.value >> 30
    }
    enlarged = tuple(
        replace(item, queue_size=sizes.get(item.number, item.queue_size)) for item in items
    )
    _check_queues(connection, enlarged, size)
    return enlarged


def _parameters(handle: int, connection: Connection, queue_size: int) -> ua.MonitoringParameters:
    """Report every sample: the trigger includes the timestamp, so constant signals are reported."""
    return ua.MonitoringParameters(
        ClientHandle=handle,
        SamplingInterval=connection.settings.sampling_interval_ms,
        Filter=ua.DataChangeFilter(
            Trigger=ua.DataChangeTrigger.StatusValueTimestamp,
            DeadbandType=ua.DeadbandType.None_,
        ),
        QueueSize=queue_size,
        DiscardOldest=True,
    )


def _check_queues(connection: Connection, items: Sequence[Item], asked: int) -> None:
    """Warn if queues are smaller than requested: an outage then loses samples earlier."""
    smallest = min(item.queue_size for item in items)
    if smallest < asked:
        _log.warning(
            "%s: queues %d values of a node instead of the requested %d",
            connection.settings.url,
            smallest,
            asked,
        )
