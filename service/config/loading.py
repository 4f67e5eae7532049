"""Reading a configuration file; every mistake is one line that names file, field and value."""

import os
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails
from pydantic_settings import SettingsError

from service.config.models import Config
from service.errors import ConfigurationError


def load_config(file: Path | None = None) -> Config:
    """Read ``file`` (TOML); without one the defaults, which fit the virtual rig, hold.

    Raises
    ------
    ConfigurationError
        naming file (or environment variable), field, value and what is allowed.
    """
    given = {} if file is None else _read(file)
    try:
        return Config(**given)
    except SettingsError as error:
        raise ConfigurationError(f"environment VALVEMAP_*: {error}") from error
    except ValidationError as error:
        lines = [_line(file, details) for details in error.errors()]
        raise ConfigurationError("\n".join(dict.fromkeys(lines))) from None


def _read(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{file}: not a text file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{file}: not valid TOML: {error}") from None


def _line(file: Path | None, details: ErrorDetails) -> str:
    # A union's tag stands among the keys of the path, though nobody wrote it.
    path = [key for key in details["loc"] if key not in {"RLS", "RML", "RBF", "Auto"}]
    field = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).lstrip(".")
    variable = "VALVEMAP_" + "__".join(str(key).upper() for key in path)
    where = f"environment variable {variable}" if variable in os.environ else (file or "defaults")
    message = details["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    if details["type"] == "extra_forbidden":
        return f"{where}: {field}: there is no such field"
    if details["type"] == "missing":
        return f"{where}: {field}: this field is required"
    value = details["input"]
    shown = f" = {value!r}" if isinstance(value, str | int | float | bool) else ""
    return f"{where}: {field}{shown}: {message}"
