"""An OPC UA server that holds up to experts and attackers, and knows nothing of valves."""

from service.hardened.address_space.blocks import Block
from service.hardened.address_space.declarations import (
    Argument,
    InvalidArgument,
    Method,
    OutOfRange,
    Variable,
)
from service.hardened.address_space.insertion import many_nodes
from service.hardened.address_space.nodes import (
    add_method,
    add_object,
    add_property,
    add_variable,
)
from service.hardened.address_space.types import Declarations, add_type
from service.hardened.address_space.units import Unit
from service.hardened.binary.encoding import instant
from service.hardened.caller import caller
from service.hardened.clock import Clock, ManualClock, SystemClock
from service.hardened.conditions.condition import (
    Condition,
    ConditionClass,
    ConditionKey,
    ConditionKind,
    event_fields,
)
from service.hardened.conditions.keeper import ConditionKeeper
from service.hardened.errors import (
    CertificateError,
    CommandRejected,
    ConfigurationError,
    HardenedError,
    ServerError,
    StorageError,
)
from service.hardened.history.events import EventHistorian, PastEvent
from service.hardened.history.historian import Historian, Records, Span
from service.hardened.lifecycle import Startable
from service.hardened.monitoring.event_filter import Event
from service.hardened.security.certificates import (
    OwnCertificate,
    Pki,
    ensure_certificate,
    expiry_warning,
    load_certificate,
    rejected,
    thumbprint,
    trust,
)
from service.hardened.security.users import Account, Role, UserStore
from service.hardened.server import HardenedServer, ServerCounters
from service.hardened.settings import Limits, Product, ServerSettings

__all__ = [
    "Account",
    "Argument",
    "Block",
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
    "SystemClock",
    "Unit",
    "UserStore",
    "Variable",
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
    "rejected",
    "thumbprint",
    "trust",
]
