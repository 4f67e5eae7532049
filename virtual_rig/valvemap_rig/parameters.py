"""Declaration of the rig's parameters with default, unit, meaning, source and bounds."""

from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Parameters(BaseModel):
    """A frozen set of parameters; unknown names are refused with the list of known ones."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="wrap")
    @classmethod
    def _names_are_known(cls, data: Any, handler: Any) -> Self:  # noqa: ANN401 - pydantic's own
        if isinstance(data, dict):
            unknown = [str(name) for name in data if name not in cls.model_fields]
            if unknown:
                raise ValueError(
                    f"unknown field {unknown[0]!r}; allowed are {', '.join(cls.model_fields)}"
                )
        validated: Self = handler(data)
        return validated


def parameter(default: Any, unit: str, description: str, source: str, **bounds: Any) -> Any:  # noqa: ANN401 - pydantic's Field is Any too
    """Return the field of a parameter: default, unit, meaning, source and allowed range."""
    return Field(
        default=default,
        description=description,
        json_schema_extra={"unit": unit, "source": source},
        **bounds,
    )


def data_sheet(model: type[BaseModel]) -> list[tuple[str, Any, str, str, str]]:
    """Return the rows (name, default, unit, description, source) of a model's parameters.

    >>> from valvemap_rig.oil import Oil
    >>> data_sheet(Oil)[0][:3]
    ('nu_40_mm2_s', 46.0, 'mm²/s')
    """
    rows = []
    for name, field in model.model_fields.items():
        extra = field.json_schema_extra
        if isinstance(extra, dict) and "source" in extra:
            unit, source = str(extra["unit"]), str(extra["source"])
            rows.append((name, field.default, unit, str(field.description), source))
    return rows
