"""Base classes of configuration sections and files."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from valvemap.vocabulary.signals import SENSORS, Signal

_LONGEST_PATH = 4_095  # bytes; the limit of Linux
NARROWEST = 1e-6  # of a range; a quotient by a narrower one has no significant digits
Number = Annotated[float, Field(ge=-1e12, le=1e12)]  # no sensor of a plant reads more
Positive = Annotated[Number, Field(gt=0.0)]
NotNegative = Annotated[Number, Field(ge=0.0)]
Seconds = Annotated[float, Field(ge=0.0, le=1e9)]  # 31 years; in ns they fit 64 bits


def rising(bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the two ends of a range, or raise ValueError."""
    if not bounds[1] - bounds[0] >= NARROWEST:
        raise ValueError(f"the first must be below the second, by {NARROWEST:g} at least")
    return bounds


def differing(values: tuple[float, float]) -> tuple[float, float]:
    """Return two values that give a scale, or raise ValueError."""
    if not abs(values[1] - values[0]) >= NARROWEST:
        raise ValueError(f"the two must differ, by {NARROWEST:g} at least")
    return values


Range = Annotated[tuple[Number, Number], AfterValidator(rising)]
TwoValues = Annotated[tuple[Number, Number], AfterValidator(differing)]


class Section(BaseModel):
    """Nothing unknown is taken, no number is infinite, nothing changes later."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _of_their_types(cls, given: object) -> object:
        """Refuse true and false as numbers, and texts that name no file."""
        if isinstance(given, Mapping):
            faults = [
                InitErrorDetails(
                    type=PydanticCustomError("type", "{fault}", {"fault": fault}),
                    loc=(name,),
                    input=value,
                )
                for name, value in given.items()
                if name in cls.model_fields
                and (fault := _fault(cls.model_fields[name].annotation, value))
            ]
            if faults:
                raise ValidationError.from_exception_data(cls.__name__, faults)
        return given


def _fault(annotation: Any, value: object) -> str:  # noqa: ANN401 - any type
    """Return why a value is none of a field of this type; "" where pydantic finds it out."""
    types = set(_types(annotation))
    truths = [one for one in _singles(value) if isinstance(one, bool)]
    if truths and bool not in types and types & {int, float}:
        return f"{str(truths[0]).lower()} is no number"
    if Path not in types or not isinstance(value, str):
        return ""
    if not value.strip() or not value.isprintable():
        return "the name of a file or a folder is allowed"
    is_long = len(os.fsencode(value)) > _LONGEST_PATH
    return f"a name of {_LONGEST_PATH} bytes at most is allowed" if is_long else ""


def _types(annotation: Any) -> Iterator[Any]:  # noqa: ANN401 - any type
    """Yield the classes within an annotation, such as float and None."""
    yield annotation
    for part in get_args(annotation):
        yield from _types(part)


def _singles(value: object) -> Iterator[object]:
    yield from value if isinstance(value, list | tuple) else (value,)


def per_signal(
    name: str, field: Callable[[Signal], tuple[Any, Any]], signals: Iterable[Signal] = SENSORS
) -> Any:  # noqa: ANN401 - a class that only exists at run time
    """Return a section with a field per signal, of type and default ``field(signal)``."""
    fields: dict[str, Any] = {signal.label: field(signal) for signal in signals}
    return create_model(name, __base__=Section, __doc__="", **fields)


class SettingsFile(BaseSettings):
    """All sections of a file; the environment overrides it: ``<PREFIX><SECTION>__<FIELD>``."""

    model_config = SettingsConfigDict(
        env_nested_delimiter="__", extra="forbid", frozen=True, allow_inf_nan=False
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],  # noqa: ARG003 - pydantic's signature
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Environment variables first, then the file (passed as arguments)."""
        return env_settings, init_settings
