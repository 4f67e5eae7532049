"""Loads configuration files; each error is one line that names file, field and value."""

import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, SettingsError

from valvemap.config.estimators import FORMER_FIELDS, FORMER_KINDS, KINDS, kind_of
from valvemap.config.models import Config
from valvemap.config.names import ALLOWED_NAME
from valvemap.errors import ConfigurationError

S = TypeVar("S", bound=BaseSettings)


def load_config(file: str | os.PathLike[str] | None = None) -> Config:
    """Load ``file`` (TOML); without one, return the defaults, which fit the virtual rig.

    Raises
    ------
    ConfigurationError
        if a value is invalid; names file (or environment variable), field, value and the allowed
        values.
    """
    return load_settings(Config, None if file is None else Path(file))


def load_settings(kind: type[S], file: Path | None) -> S:
    """Load settings of another class, like `load_config`.

    Raises
    ------
    ConfigurationError
        if a value is invalid; names file (or environment variable), field, value and the allowed
        values.
    """
    remedy = "; `valvemap init` makes a first configuration"
    given = {} if file is None else read_toml(file, remedy)
    try:
        return kind(**given)
    except SettingsError as error:
        prefix = kind.model_config.get("env_prefix")
        raise ConfigurationError(f"environment {prefix}*: {error}") from error
    except ValidationError as error:
        lines = [_line(kind, file, details) for details in error.errors()]
        raise ConfigurationError("\n".join(dict.fromkeys(lines))) from None


def check_has_valves(config: Config, what: str) -> None:
    """Refuse a configuration of axes alone; ``what`` is the work that is of valves.

    Raises
    ------
    ConfigurationError
        if there is no valve.
    """
    if not config.valves:
        raise ConfigurationError(
            f"there are axes and no valve: {what} is of valves; `valvemap serve` identifies axes, "
            "`valvemap axis FILE` a recording of one"
        )


def config_of(config: Config, name: str) -> Config:
    """Return the configuration of one valve and its source.

    Raises
    ------
    ConfigurationError
        if there is no such valve; names those that there are.
    """
    valve = next((valve for valve in config.valves if valve.name == name), None)
    if valve is None:
        there = ", ".join(valve.name for valve in config.valves)
        raise ConfigurationError(f"VALVE {name!r}: the configuration has {there}")
    one = config if valve.source is None else config.only(valve.source)
    (own,) = (valve for valve in one.valves if valve.name == name)
    return one.model_copy(update={"valves": (own,)})


def read_toml(file: Path, remedy: str = "") -> dict[str, Any]:
    """Read a TOML file; ``remedy`` follows the sentence that there is none.

    Raises
    ------
    ConfigurationError
    """
    try:
        return tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ConfigurationError(f"{file}: no such file or directory{remedy}") from None
    except OSError as error:
        raise ConfigurationError(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{file}: not a text file in UTF-8; save it so") from None
    except tomllib.TOMLDecodeError as error:
        quotes = "; text goes in quotes" if str(error).startswith("Invalid") else ""
        raise ConfigurationError(f"{file}: not valid TOML: {error}{quotes}") from None


def _nearest(kind: type[BaseSettings], path: Sequence[str | int]) -> str:
    """Return a hint with the closest field name, if one is similar."""
    sections: list[Any] = [kind]
    for key in path[:-1]:
        if isinstance(key, int):
            continue
        if key in KINDS:  # the path contains the tag of a union
            sections = [section for section in sections if kind_of(section) == key]
            continue
        field = sections[0].model_fields.get(key) if sections else None
        sections = list(_models(field.annotation)) if field is not None else []
    if not sections:
        return ""
    return nearest(str(path[-1]), sections[0].model_fields)


def nearest(name: str, fields: Iterable[str]) -> str:
    """Return what follows a name that is none of the fields: the closest one, or all.

    >>> nearest("valu", ["value", "min"]), nearest("x", ["value", "min"])
    ('; is value meant?', '; there are value, min')
    """
    known = list(fields)
    near = get_close_matches(name, known, n=1)
    return f"; is {near[0]} meant?" if near else f"; there are {', '.join(known)}"


def _models(annotation: Any) -> Iterator[Any]:  # noqa: ANN401 - any type
    """Return the models within a type."""
    if hasattr(annotation, "model_fields"):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _sentence(details: ErrorDetails) -> str:
    """Return a sentence with the fault and the allowed values."""
    kind, context = details["type"], details.get("ctx", {})
    last = next((str(key) for key in reversed(details["loc"]) if isinstance(key, str)), "")
    if kind == "string_pattern_mismatch":
        return _FORMS.get(last, _FORMS["name"])
    if kind == "union_tag_invalid" and context["tag"] in FORMER_KINDS:
        return f"kind {context['tag']!r} has another name: write {FORMER_KINDS[context['tag']]!r}"
    if kind == "union_tag_invalid":
        return f"kind {context['tag']!r:.60}: allowed is one of {context['expected_tags']}"
    if kind == "union_tag_not_found":
        return f"kind is missing: allowed is one of {', '.join(KINDS)}"
    if kind in _SHAPES:
        return _SHAPES[kind]
    message = details["msg"].removeprefix("Value error, ")
    return message[:1].lower() + message[1:]


_LOG_IN = re.compile(r"//[^/@]*@")  # credentials in a URL
_FORMS = {
    "url": "allowed is opc.tcp://HOST:PORT/PATH",
    "broker": "allowed is mqtt://HOST or mqtts://HOST, with :PORT where it is not 1883 or 8883",
    "group": "allowed are words without / + #, a space between them, 64 characters at most",
    "edge_node": "allowed are words without / + #, a space between them, 64 characters at most",
    "primary_host": "allowed are words without / + #, a space between them, 64 characters at most",
    "name": ALLOWED_NAME,
}
_SHAPES = {
    "tuple_type": "a list is needed, [a, b], or a section [[…]] for each",
    "model_type": "a section is needed, [name] with fields below it",
    "model_attributes_type": "a section is needed, [name] with fields below it",
    "dict_type": "a table is needed, { name = value }",
}


def _line(kind: type[BaseSettings], file: Path | None, details: ErrorDetails) -> str:
    # The path contains the tag of a union, which is not a key of the file.
    path = [key for key in details["loc"] if key not in KINDS]
    field = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).lstrip(".")
    prefix = kind.model_config.get("env_prefix", "")
    variable = prefix + "__".join(str(key).upper() for key in path)
    where = f"environment variable {variable}" if variable in os.environ else (file or "defaults")
    message = _sentence(details)
    if details["type"] == "extra_forbidden" and path[-1] in FORMER_FIELDS:
        return f"{where}: {field}: {FORMER_FIELDS[path[-1]]}"
    if details["type"] == "extra_forbidden":
        return f"{where}: {field}: there is no such field{_nearest(kind, details['loc'])}"
    if details["type"] == "missing":
        return f"{where}: {field}: this field is required"
    value = details["input"]
    if isinstance(value, str):
        value = _LOG_IN.sub("//***@", value)
    single = value if isinstance(value, list | tuple) else [value]
    is_shown = all(isinstance(one, str | int | float | bool) for one in single)
    shown = f" = {value!r:.200}" if is_shown else ""
    return f"{where}: {field}{shown}: {message}"
