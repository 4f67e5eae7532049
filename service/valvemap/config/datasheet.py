"""A valve's datasheet and tolerances (TOML), with which a measured sheet is compared."""

import math
import tomllib
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from valvemap.errors import ConfigurationError
from valvemap.model.sheet import KEYS


class Expected(BaseModel):
    """What is expected of one figure, in its unit: what the datasheet says, what is allowed."""

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
    """The rated conditions, and what is expected of each figure, by its key."""

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
        naming file, field and what is allowed.
    """
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{file}: not TOML: {error}") from None
    try:
        return Datasheet.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "datasheet"
        said = first["msg"].removeprefix("Value error, ")
        raise ConfigurationError(f"{file}: {where}: {said}") from None
