"""An OPC UA server that holds up to experts and attackers, and knows nothing of valves."""

from service.clock import Clock, ManualClock, SystemClock
from service.errors import (
    CertificateError,
    CommandRejected,
    ConfigurationError,
    ServerError,
    StorageError,
    ValvemapError,
)
from service.opcua.hardened.blocks import Block
from service.opcua.hardened.certificates import (
    OwnCertificate,
    Pki,
    ensure_certificate,
    expiry_warning,
    load_certificate,
    rejected,
    thumbprint,
    trust,
)
from service.opcua.hardened.insertion import many_nodes
from service.opcua.hardened.lifecycle import Startable
from service.opcua.hardened.nodes import (
    Argument,
    InvalidArgument,
    Method,
    OutOfRange,
    Variable,
    add_method,
    add_object,
    add_variable,
)
from service.opcua.hardened.server import HardenedServer, ServerCounters
from service.opcua.hardened.settings import Limits, ServerSettings
from service.opcua.hardened.units import Unit
from service.opcua.hardened.users import Account, Role, UserStore

__all__ = [
    "Account",
    "Argument",
    "Block",
    "CertificateError",
    "Clock",
    "CommandRejected",
    "ConfigurationError",
    "HardenedServer",
    "InvalidArgument",
    "Limits",
    "ManualClock",
    "Method",
    "OutOfRange",
    "OwnCertificate",
    "Pki",
    "Role",
    "ServerCounters",
    "ServerError",
    "ServerSettings",
    "Startable",
    "StorageError",
    "SystemClock",
    "Unit",
    "UserStore",
    "ValvemapError",
    "Variable",
    "add_method",
    "add_object",
    "add_variable",
    "ensure_certificate",
    "expiry_warning",
    "load_certificate",
    "many_nodes",
    "rejected",
    "thumbprint",
    "trust",
]
