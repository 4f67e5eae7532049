"""A hardened OPC UA server; it is independent of the application that it serves.

`HardenedServer` is created from `ServerSettings` (address, certificates, users, limits).
`add_object`, `add_variable` and `add_method` build its address space, `HardenedServer.write`
publishes values. `Block` publishes arrays of values, `Historian` and `ConditionKeeper` are the
owner's ports for history and alarms.

Examples
--------
>>> import asyncio
>>> settings = ServerSettings(
...     url="opc.tcp://127.0.0.1:0/plant/",
...     application_uri="urn:example:server",
...     application_name="plant",
...     namespace_uri="urn:example:plant",
...     none_on_loopback=True,
... )
>>> async def publish(speed: float, now: int) -> str:
...     async with await HardenedServer.create(settings) as server:
...         pump = await add_object(server, None, "Pump")
...         variable = await add_variable(server, pump, "Pump.Speed", 0.0)
...         server.write([(variable, speed, 0, now)])  # 0: the status code Good
...         return variable.id.to_string()
>>> asyncio.run(publish(1450.0, now=1_800_000_000_000_000_000))
'ns=2;s=Pump.Speed'
"""

from guarded_opcua.address_space.blocks import Block
from guarded_opcua.address_space.declarations import (
    Argument,
    InvalidArgument,
    Method,
    OutOfRange,
    Variable,
)
from guarded_opcua.address_space.insertion import many_nodes
from guarded_opcua.address_space.node_sets import refer, refer_back
from guarded_opcua.address_space.nodes import (
    add_method,
    add_object,
    add_property,
    add_variable,
)
from guarded_opcua.address_space.types import Declarations, add_enumeration, add_type
from guarded_opcua.address_space.units import Unit
from guarded_opcua.binary.encoding import instant
from guarded_opcua.caller import caller
from guarded_opcua.clock import Clock, ManualClock, SystemClock
from guarded_opcua.conditions.condition import (
    Condition,
    ConditionClass,
    ConditionKey,
    ConditionKind,
    event_fields,
)
from guarded_opcua.conditions.keeper import ConditionKeeper
from guarded_opcua.errors import (
    CertificateError,
    CommandRejected,
    ConfigurationError,
    HardenedError,
    ServerError,
    StorageError,
)
from guarded_opcua.history.events import EventHistorian, PastEvent
from guarded_opcua.history.historian import Cells, Historian, Records, Span, Summarising
from guarded_opcua.lifecycle import Startable
from guarded_opcua.monitoring.events import Event
from guarded_opcua.security.accounts import Account, Role
from guarded_opcua.security.certificates import expiry_warning, load_certificate, thumbprint
from guarded_opcua.security.own_certificate import OwnCertificate, ensure_certificate
from guarded_opcua.security.pki_folders import Pki, rejected, trust
from guarded_opcua.security.users import UserStore
from guarded_opcua.server import HardenedServer, ServerCounters
from guarded_opcua.settings import Limits, Product, ServerSettings

__all__ = [
    "Account",
    "Argument",
    "Block",
    "Cells",
    "CertificateError",
    "Clock",
    "CommandRejected",
    "Condition",
    "ConditionClass",
    "ConditionKeeper",
    "ConditionKey",
    "ConditionKind",
    "ConfigurationError",
    "Declarations",
    "Event",
    "EventHistorian",
    "HardenedError",
    "HardenedServer",
    "Historian",
    "InvalidArgument",
    "Limits",
    "ManualClock",
    "Method",
    "OutOfRange",
    "OwnCertificate",
    "PastEvent",
    "Pki",
    "Product",
    "Records",
    "Role",
    "ServerCounters",
    "ServerError",
    "ServerSettings",
    "Span",
    "Startable",
    "StorageError",
    "Summarising",
    "SystemClock",
    "Unit",
    "UserStore",
    "Variable",
    "add_enumeration",
    "add_method",
    "add_object",
    "add_property",
    "add_type",
    "add_variable",
    "caller",
    "ensure_certificate",
    "event_fields",
    "expiry_warning",
    "instant",
    "load_certificate",
    "many_nodes",
    "refer",
    "refer_back",
    "rejected",
    "thumbprint",
    "trust",
]
