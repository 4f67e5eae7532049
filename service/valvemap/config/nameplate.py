"""The name plate of a valve and its designation in the plant."""

from typing import Annotated

from pydantic import Field

from valvemap.config.sections import Section
from valvemap.pipeline.nameplate import Nameplate

Said = Annotated[str, Field(min_length=1, max_length=256)]
Uri = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9+.-]*:\S+$", max_length=256)]


class IdentificationConfig(Section):
    """The valve's nameplate below Identification (Devices, Machinery); omitted: not known."""

    manufacturer: Said | None = Field(None, description="manufacturer of the valve")
    manufacturer_uri: Uri | None = Field(None, description="the maker's own URI")
    model: Said | None = Field(None, description="the maker's name of the type")
    product_code: Said | None = Field(None, description="the maker's order code")
    serial_number: Said | None = Field(None, description="unique among the maker's")
    product_instance_uri: Uri | None = Field(
        None, description="unique in the world, if the maker gave one"
    )
    hardware_revision: Said | None = Field(None, description="revision of the hardware")
    component_name: Said | None = Field(
        None, description="name in the plant; none = the valve's name"
    )
    asset_id: Said | None = Field(None, description="its number in the plant")
    location: Said | None = Field(None, description="location in the plant")

    def nameplate(self, name: str) -> Nameplate:
        """Return the name plate of the valve ``name``."""
        known = {field: text for field, text in self.model_dump().items() if text is not None}
        return Nameplate(**{"component_name": name} | known)
