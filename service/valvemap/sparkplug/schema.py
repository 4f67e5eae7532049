"""The payload of Sparkplug B 3.0 (chapter 6) as a Protocol Buffers message.

It declares only the fields that an edge node writes or reads in commands: no data sets, files or
parameters of templates. Field numbers are the specification's.
"""

from enum import IntEnum
from typing import Any, Final

from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

__all__ = ["DataType", "DecodeError", "Payload"]


class DataType(IntEnum):
    """Data types of metrics and properties in use."""

    INT8 = 1
    INT16 = 2
    INT32 = 3
    INT64 = 4
    UINT8 = 5
    UINT16 = 6
    UINT32 = 7
    UINT64 = 8
    FLOAT = 9
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12
    DATE_TIME = 13
    TEMPLATE = 19


_PACKAGE: Final = "org.eclipse.tahu.protobuf"
_KINDS: Final = {
    "uint32": FieldDescriptorProto.TYPE_UINT32,
    "uint64": FieldDescriptorProto.TYPE_UINT64,
    "float": FieldDescriptorProto.TYPE_FLOAT,
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "bool": FieldDescriptorProto.TYPE_BOOL,
    "string": FieldDescriptorProto.TYPE_STRING,
}
_VALUES: Final = (
    ("int_value", "uint32"),
    ("long_value", "uint64"),
    ("float_value", "float"),
    ("double_value", "double"),
    ("boolean_value", "bool"),
    ("string_value", "string"),
)


def _payload() -> Any:  # noqa: ANN401 - a class that is made here
    payload = DescriptorProto(name="Payload")
    _add(payload, 1, "timestamp", "uint64")
    _add(payload, 2, "metrics", "Payload.Metric", repeated=True)
    _add(payload, 3, "seq", "uint64")

    metric = payload.nested_type.add(name="Metric")
    _add(metric, 1, "name", "string")
    _add(metric, 2, "alias", "uint64")
    _add(metric, 3, "timestamp", "uint64")
    _add(metric, 4, "datatype", "uint32")
    _add(metric, 5, "is_historical", "bool")
    _add(metric, 7, "is_null", "bool")
    _add(metric, 9, "properties", "Payload.PropertySet")
    _add_value(metric, 10)
    _add(metric, 18, "template_value", "Payload.Template").oneof_index = 0

    template = payload.nested_type.add(name="Template")
    _add(template, 2, "metrics", "Payload.Metric", repeated=True)
    _add(template, 4, "template_ref", "string")
    _add(template, 5, "is_definition", "bool")

    properties = payload.nested_type.add(name="PropertySet")
    _add(properties, 1, "keys", "string", repeated=True)
    _add(properties, 2, "values", "Payload.PropertyValue", repeated=True)

    value = payload.nested_type.add(name="PropertyValue")
    _add(value, 1, "type", "uint32")
    _add(value, 2, "is_null", "bool")
    _add_value(value, 3)

    file = FileDescriptorProto(name="sparkplug_b.proto", package=_PACKAGE, syntax="proto2")
    file.message_type.append(payload)
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.Payload"))


def _add(
    message: DescriptorProto, number: int, name: str, kind: str, *, repeated: bool = False
) -> FieldDescriptorProto:
    field = message.field.add(name=name, number=number)
    field.label = (
        FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
    )
    if kind in _KINDS:
        field.type = _KINDS[kind]
    else:
        field.type = FieldDescriptorProto.TYPE_MESSAGE
        field.type_name = f".{_PACKAGE}.{kind}"
    return field


def _add_value(message: DescriptorProto, first: int) -> None:
    """Add the ``value`` oneof, with consecutive field numbers."""
    message.oneof_decl.add(name="value")
    for number, (name, kind) in enumerate(_VALUES, first):
        _add(message, number, name, kind).oneof_index = 0


Payload: Final = _payload()
"""Message class of `google.protobuf`."""
