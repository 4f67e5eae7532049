"""A valve's datasheet and tolerances (TOML), with which a measured sheet is compared."""

import math
from pathlib import Path
from typing import Self

from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from valvemap.config.loading import nearest, read_toml
from valvemap.config.sections import Section
from valvemap.errors import ConfigurationError
from valvemap.model.sheet_figures import LEAST, names_of


class Expected(Section):
    """Datasheet's value and tolerances of one figure, in its unit."""

    value: float | None = Field(None, description="value of the datasheet")
    min: float = Field(-math.inf, description="least value that passes")
    max: float = Field(math.inf, description="largest value that passes")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.model_fields_set:
            raise ValueError("value, min or max is needed")
        if self.min > self.max:
            raise ValueError(f"min {self.min:g} is above max {self.max:g}")
        return self


class Datasheet(Section):
    """Rated pressure drop, and the datasheet's values and tolerances by the figure's key."""

    rated_dp_bar: float | None = Field(None, gt=0.0, description="pressure drop, bar")
    figures: dict[str, Expected] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known(self) -> Self:
        names = names_of(2)
        for key, expected in self.figures.items():
            if key not in names:
                raise ValueError(f"there is no figure {key!r}; allowed are {', '.join(names)}")
            for field in ("value", "max"):
                given, least = getattr(expected, field), LEAST[key]
                if given is not None and given < least:
                    raise ValueError(
                        f"figures.{key}.{field} = {given:g}: no {names[key]} is below {least:g}"
                    )
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
        raise ConfigurationError(f"{file}: {_sentence(error.errors()[0])}") from None


def _sentence(first: ErrorDetails) -> str:
    """Return field, value and fault."""
    where, kind, value = ".".join(map(str, first["loc"])), first["type"], first["input"]
    if kind == "extra_forbidden":
        of = Datasheet if len(first["loc"]) == 1 else Expected
        return f"{where}: there is no such field{nearest(str(first['loc'][-1]), of.model_fields)}"
    if kind == "model_type":
        return f"{where}: a section is needed, [{where}] with {', '.join(Expected.model_fields)}"
    if kind == "dict_type":
        return f"{where}: a section is needed for each figure, [{where}.rated_flow]"
    said = first["msg"].removeprefix("Value error, ")
    shown = f" = {value!r:.80}" if isinstance(value, str | int | float) else ""
    return f"{where}{shown}: {said[:1].lower()}{said[1:]}" if where else said
