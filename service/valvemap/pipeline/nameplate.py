"""Nameplate of a valve: manufacturer's data and the plant's tag."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Nameplate:
    """Manufacturer, identification and tag of a valve; empty: not configured.

    >>> Nameplate(manufacturer="Muster AG").serial_number
    ''
    """

    manufacturer: str = ""
    manufacturer_uri: str = ""
    model: str = ""
    product_code: str = ""
    serial_number: str = ""
    product_instance_uri: str = ""
    hardware_revision: str = ""
    component_name: str = ""
    asset_id: str = ""
    location: str = ""


BLANK = Nameplate()
