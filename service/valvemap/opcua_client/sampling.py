"""How a server samples the variables of a subscription."""

from dataclasses import dataclass
from typing import Final

from asyncua import ua


@dataclass(frozen=True)
class Sampling:
    """How a server samples a variable.

    Attributes
    ----------
    every_s
        Sampling interval; of several values within it only the last is reported.
    queue
        Queue size in values, for delayed publishing.
    equal_too
        Whether an equal value with a new timestamp is a change: it shows that the valve is alive.
    """

    every_s: float
    queue: int
    equal_too: bool


CLOSELY: Final = Sampling(0.05, 40, equal_too=True)


def sampled_item(node: ua.NodeId, handle: int, sampling: Sampling) -> ua.MonitoredItemCreateRequest:
    """Return the request for an item with the handle ``handle``."""
    trigger = ua.DataChangeTrigger.StatusValue
    if sampling.equal_too:
        trigger = ua.DataChangeTrigger.StatusValueTimestamp
    return ua.MonitoredItemCreateRequest(
        ItemToMonitor=ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.Value),
        MonitoringMode=ua.MonitoringMode.Reporting,
        RequestedParameters=ua.MonitoringParameters(
            ClientHandle=handle,
            SamplingInterval=sampling.every_s * 1e3,
            Filter=ua.DataChangeFilter(Trigger=trigger, DeadbandType=ua.DeadbandType.None_),
            QueueSize=sampling.queue,
            DiscardOldest=True,
        ),
    )
