"""Requests of most services, and packets made of them that break the rules somewhere."""

import struct

from asyncua import ua


def mutated(body, dice):
    """Break a packet in one to four places: bytes, lengths, cuts, insertions, repetitions."""
    for _ in range(dice.randint(1, 4)):
        first = dice.choice((4, 70))  # half of them leave the header alone
        at = dice.randrange(min(first, len(body) - 1), len(body))
        match dice.randrange(5):
            case 0:
                body[at] = dice.randrange(256)
            case 1:
                body[at : at + 4] = struct.pack(
                    "<i", dice.choice([-1, -2, 0, 2**31 - 1, -(2**31), 1_000_000])
                )
            case 2:
                del body[at : at + dice.randint(1, 8)]
            case 3:
                body[at:at] = dice.randbytes(dice.randint(1, 16))
            case 4:
                body += body[at:] * dice.randint(1, 3)
    return bytes(body[:60_000])


def requests(node):
    """Return makers of requests, each called with the token of a session."""

    def made(kind, **fields):
        def make(token):
            request = kind()
            request.RequestHeader.AuthenticationToken = token
            for name, content in fields.items():
                setattr(request.Parameters, name, content)
            return request

        return make

    item = ua.MonitoredItemCreateRequest(
        ua.ReadValueId(node, ua.AttributeIds.Value),
        ua.MonitoringMode.Reporting,
        ua.MonitoringParameters(
            1, 0.0, ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, 1, 0.5), 10
        ),
    )
    path = ua.RelativePath([ua.RelativePathElement(TargetName=ua.QualifiedName("Plant", 2))])
    matrix = ua.Variant([[1.0, 2.0], [3.0, 4.0]], ua.VariantType.Double)
    return [
        made(ua.ReadRequest, NodesToRead=[ua.ReadValueId(node, 13, "0:1")]),
        made(ua.WriteRequest, NodesToWrite=[ua.WriteValue(node, 13, None, ua.DataValue(matrix))]),
        made(ua.BrowseRequest, NodesToBrowse=[ua.BrowseDescription(node)]),
        made(ua.CallRequest, MethodsToCall=[ua.CallMethodRequest(node, node, [matrix, matrix])]),
        made(ua.TranslateBrowsePathsToNodeIdsRequest, BrowsePaths=[ua.BrowsePath(node, path)]),
        made(ua.CreateSubscriptionRequest, RequestedPublishingInterval=float("nan")),
        made(ua.CreateMonitoredItemsRequest, SubscriptionId=1, ItemsToCreate=[item]),
        made(ua.ModifySubscriptionRequest, SubscriptionId=1),
        made(ua.TransferSubscriptionsRequest, SubscriptionIds=[1, 2]),
        made(ua.RepublishRequest, SubscriptionId=1, RetransmitSequenceNumber=1),
        made(ua.PublishRequest),
    ]
