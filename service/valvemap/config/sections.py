"""Base classes of configuration sections and files."""

from collections.abc import Callable, Iterable
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from valvemap.vocabulary.signals import SENSORS, Signal

NARROWEST = 1e-6  # of a range; what is divided by a narrower one has no digits left
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
