"""What is said of a valve itself, beside what is measured: its maker's plate, its plant's tag."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Nameplate:
    """Who made a valve, which one it is, and what its plant calls it; empty: nobody said so.

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
