"""A valve's datasheet and tolerances (TOML), with which a measured sheet is compared."""

import math
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from valvemap.config.loading import nearest, read_toml
from valvemap.errors import ConfigurationError
from valvemap.model.sheet_figures import KEYS


class Expected(BaseModel):
    """Datasheet's value and tolerances of one figure, in its unit."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    value: float | None = Field(None, description="value of the datasheet")
    min: float = Field(-math.inf, description="least value that passes")
    max: float = Field(math.inf, description="largest value that passes")

    @model_validator(mode="after")
    def _ordered(self) -> "Expected":
        if self.min > self.max:
            raise ValueError(f"min {self.min:g} is above max {self.max:g}")
        return self


class Datasheet(BaseModel):
    """Rated pressure drop, and the datasheet's values and tolerances by the figure's key."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rated_dp_bar: float | None = Field(None, gt=0.0, description="pressure drop, bar")
    figures: dict[str, Expected] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known(self) -> "Datasheet":
        for key in self.figures:
            if key not in KEYS:
                raise ValueError(f"there is no figure {key!r}; allowed are {', '.join(KEYS)}")
        return self


def read_datasheet(file: Path) -> Datasheet:
    """Read a datasheet.

    Raises
    ------
    ConfigurationError
        naming file, field and the allowed values.
    """
    content = read_toml(file)
    try:
        return Datasheet.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "datasheet"
        said = first["msg"].removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            of = Datasheet if len(first["loc"]) == 1 else Expected
            said = f"there is no such field{nearest(str(first['loc'][-1]), of.model_fields)}"
        elif first["type"] == "model_type":
            said = f"a section is needed, [{where}] with {', '.join(Expected.model_fields)}"
        raise ConfigurationError(f"{file}: {where}: {said}") from None
