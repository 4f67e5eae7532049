"""NamespaceMetadata of the server's namespace (Part 5, 6.3.13)."""

import datetime as dt

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.insertion import insert, property_item

_Ids = ua.ObjectIds
_ANY_STRING = "*"


def describe_namespace(
    aspace: AddressSpace, index: int, uri: str, version: str, published: dt.datetime
) -> ua.NodeId:
    """Add the NamespaceMetadata of a namespace below Server/Namespaces.

    The ids of the namespace are strings and do not change between runs.
    """
    item = ua.AddNodesItem()
    item.ParentNodeId = ua.NodeId(_Ids.Server_Namespaces)
    item.RequestedNewNodeId = ua.NodeId(uri, index)
    item.BrowseName = ua.QualifiedName(uri, index)
    item.NodeClass = ua.NodeClass.Object
    item.ReferenceTypeId = ua.NodeId(_Ids.HasComponent)
    item.TypeDefinition = ua.NodeId(_Ids.NamespaceMetadataType)
    item.NodeAttributes = ua.ObjectAttributes(DisplayName=ua.LocalizedText(uri), EventNotifier=0)
    own = insert(aspace, item, published)
    types = ua.VariantType
    for name, value, data_type in (
        ("NamespaceUri", ua.Variant(uri, types.String), _Ids.String),
        ("NamespaceVersion", ua.Variant(version, types.String), _Ids.String),
        ("NamespacePublicationDate", ua.Variant(published, types.DateTime), _Ids.DateTime),
        ("IsNamespaceSubset", ua.Variant(False, types.Boolean), _Ids.Boolean),  # noqa: FBT003
        ("StaticNodeIdTypes", ua.Variant([1], types.Int32, is_array=True), _Ids.IdType),
        (
            "StaticNumericNodeIdRange",
            ua.Variant([], types.String, is_array=True),
            _Ids.NumericRange,
        ),
        ("StaticStringNodeIdPattern", ua.Variant(_ANY_STRING, types.String), _Ids.String),
    ):
        shown = property_item(own, ua.NodeId(f"{uri}.{name}", index), name, 0)
        shown.NodeAttributes.Value = value
        shown.NodeAttributes.DataType = ua.NodeId(data_type)
        rank = ua.ValueRank.OneDimension if value.is_array else ua.ValueRank.Scalar
        shown.NodeAttributes.ValueRank = rank
        insert(aspace, shown, published)
    return own
