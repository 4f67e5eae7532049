"""Valves in the terms of Devices (DI, OPC 10000-100) and Machinery (OPC 40001-1, -2).

``node_sets`` holds the part of each namespace that the server uses, with the original NodeIds.
Valves are organized by DI's DeviceSet as well as by our own root. Further references add the
Identification and DeviceHealth.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from asyncua import ua

from guarded_opcua import (
    HardenedServer,
    Variable,
    add_object,
    add_property,
    add_variable,
    refer,
    refer_back,
)
from valvemap.opcua_results.information_model import DEVICE_HEALTH, IDENTIFICATION
from valvemap.pipeline.nameplate import Nameplate

DI = "http://opcfoundation.org/UA/DI/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"
PADIM = "http://opcfoundation.org/UA/PADIM/"
PROCESS = "http://opcfoundation.org/UA/Machinery/ProcessValues/"
NODE_SETS = Path(__file__).parent / "node_sets"
_NAMES = "di", "machinery", "padim", "process_values"
_FILES = tuple(f"{name}.NodeSet2.xml" for name in _NAMES)  # each needs those before
_DEVICE_SET, _I_DEVICE_HEALTH, _HEALTH_ENUMERATION = 5001, 15051, 6244  # of DI
_COMPONENT_IDENTIFICATION, _I_MACHINE_TAG_NAMEPLATE = 1005, 1011  # of Machinery
_NEEDED = {"Manufacturer", "SerialNumber"}  # mandatory in the type
_LOCALIZED = {"Manufacturer", "Model", "ComponentName"}
_LOCATION = "Location"
_UNKNOWN = ua.StatusCodes.UncertainInitialValue


@dataclass(frozen=True)
class Companions:
    """The namespace indices of DI, Machinery, PA-DIM and Process Values at one server."""

    server: HardenedServer
    di: int
    machinery: int
    padim: int
    process_values: int

    def list_device(self, owner: ua.NodeId) -> None:
        """Add an Organizes reference from the DeviceSet to a valve.

        Call this before the valve's folder is deferred with ``add_later``.
        """
        aspace = self.server.address_space
        refer(aspace, self.device_set, ua.ObjectIds.Organizes, owner)

    @property
    def device_set(self) -> ua.NodeId:
        """NodeId of the DeviceSet, which organizes the valves."""
        return self._of_di(_DEVICE_SET)

    async def add_identification(self, owner: ua.NodeId, plate: Nameplate) -> None:
        """Add the Identification of a valve, from its name plate.

        Optional properties that are not configured are left out; mandatory ones are Uncertain.
        """
        server = self.server
        organizes = ua.ObjectIds.Organizes
        refer_back(server.address_space, self.device_set, organizes, owner)
        own = await add_object(
            server,
            owner,
            f"{owner.Identifier}.{IDENTIFICATION}",
            description="The valve's name plate, as configured.",
            type_definition=ua.NodeId(_COMPONENT_IDENTIFICATION, self.machinery),
            name=ua.QualifiedName("Identification", self.di),
            as_add_in=True,
        )
        for name, text, words in (
            ("Manufacturer", plate.manufacturer, "Manufacturer of the valve."),
            ("ManufacturerUri", plate.manufacturer_uri, "The maker's own URI."),
            ("Model", plate.model, "The maker's name of the type."),
            ("ProductCode", plate.product_code, "The maker's order code."),
            ("SerialNumber", plate.serial_number, "Unique among the maker's."),
            ("ProductInstanceUri", plate.product_instance_uri, "Unique in the world."),
            ("HardwareRevision", plate.hardware_revision, "Revision of the hardware."),
            ("ComponentName", plate.component_name, "Name of the valve in the plant."),
            ("AssetId", plate.asset_id, "Its number in the plant."),
            (_LOCATION, plate.location, "Location in the plant."),
        ):
            if text or name in _NEEDED:
                at = self.machinery if name == _LOCATION else self.di
                await add_property(
                    server,
                    own,
                    ua.QualifiedName(name, at),
                    ua.LocalizedText(text) if name in _LOCALIZED else text,
                    code=ua.StatusCodes.Good if text else _UNKNOWN,
                    description=words,
                )
        if plate.location:
            tag = ua.NodeId(_I_MACHINE_TAG_NAMEPLATE, self.machinery)
            refer(server.address_space, own, ua.ObjectIds.HasInterface, tag)

    async def add_health(self, owner: ua.NodeId, whose: str) -> Variable:
        """Add the DeviceHealth of an owner, which the description calls ``whose``."""
        server = self.server
        interface = self._of_di(_I_DEVICE_HEALTH)
        refer(server.address_space, owner, ua.ObjectIds.HasInterface, interface)
        return await add_variable(
            server,
            owner,
            f"{owner.Identifier}.{DEVICE_HEALTH}",
            None,
            description=f"Health of the {whose} by NAMUR NE 107, from its active alarms.",
            type=ua.VariantType.Int32,
            data_type=self._of_di(_HEALTH_ENUMERATION),
            name=ua.QualifiedName("DeviceHealth", self.di),
        )

    def _of_di(self, number: int) -> ua.NodeId:
        return ua.NodeId(number, self.di)


async def add_companions(server: HardenedServer) -> Companions:
    """Add the nodes of the companions; call this before other nodes refer to them."""
    for text in _texts():
        await server.add_node_set(text)
    uris = DI, MACHINERY, PADIM, PROCESS
    return Companions(server, *[await server.namespace(uri) for uri in uris])


@cache
def _texts() -> tuple[str, ...]:
    return tuple((NODE_SETS / file).read_text(encoding="utf-8") for file in _FILES)
