"""Base classes of configuration sections and files."""

from collections.abc import Callable, Iterable
from typing import Any

from pydantic import BaseModel, ConfigDict, create_model
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from valvemap.vocabulary.signals import SENSORS, Signal


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
