"""The page of the configuration, generated from its models."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from documentation.tables import table
from valvemap.config.models import Config

Schema = Mapping[str, Any]

_HEAD = """# Configuration

A TOML file: `valvemap connect` writes one for a server, `valvemap init` one to edit, `valvemap
check-config FILE` checks it. Every field of a section can be set in the environment instead:
`VALVEMAP_<SECTION>__<FIELD>`, such as `VALVEMAP_SOURCE__URL=opc.tcp://plc:4840`. What is left out
has the default; *needed* has none. An unknown name, or a value beyond its bounds, is an error that
names file, field, value and what is allowed. No number is beyond ± 1e12.
"""
_KINDS = {"string": "text", "integer": "whole number", "number": "number", "null": "none"}
_BOUNDS = (
    ("minimum", "≥"),
    ("exclusiveMinimum", ">"),
    ("maximum", "≤"),
    ("exclusiveMaximum", "<"),
)
_ANY = 1e12  # what bounds every number is not repeated in each row


def configuration_page() -> str:
    """Return the page with the type, default and meaning of all sections and fields."""
    schema = Config.model_json_schema()
    models: Mapping[str, Schema] = schema["$defs"]
    parts = [_HEAD]
    for name, field in schema["properties"].items():
        for model in _models_in(field):
            parts += _section(name, field, models[model], models)
    return "\n".join(parts)


def undescribed() -> list[str]:
    """Return the fields without a description."""
    models: Mapping[str, Schema] = Config.model_json_schema()["$defs"]
    return [
        f"{model}.{name}"
        for model, schema in models.items()
        for name, field in schema["properties"].items()
        if not _models_in(field) and "const" not in field and "description" not in field
    ]


def _section(path: str, field: Schema, model: Schema, models: Mapping[str, Schema]) -> list[str]:
    """Return the lines of a section and its subsections."""
    one = f"[[{path}]]" if field.get("type") == "array" else f"[{path}]"
    kind = model["properties"].get("kind", {}).get("const")
    title = f"`{one}`" if kind is None else f'`{one}` with `kind = "{kind}"`'
    parts = [f"## {title}\n", f"{model.get('description', '').splitlines()[0]}\n"]
    rows = list(_rows(model))
    if rows:
        parts.append(table(["field", "allowed", "default", "meaning"], rows) + "\n")
    documented: set[str] = set()
    for inner in model["properties"].values():
        for below in _models_in(inner):
            alike = [n for n, f in model["properties"].items() if below in _models_in(f)]
            if below in documented:
                continue
            documented.add(below)
            parts += _section(f"{path}.{'|'.join(alike)}", inner, models[below], models)
    return parts


def _rows(model: Schema) -> Iterator[list[str]]:
    needed = model.get("required", [])
    for name, field in model["properties"].items():
        if _models_in(field) or "const" in field:
            continue
        default = "needed" if name in needed else _shown(field.get("default", ""))
        yield [f"`{name}`", _allowed(field), default, field.get("description", "")]


def _models_in(field: Schema) -> list[str]:
    """Return the names of a field's models."""
    items = field.get("items", {})
    parts = [field, items, *items.get("oneOf", []), *field.get("anyOf", [])]
    return [part["$ref"].rpartition("/")[2] for part in parts if "$ref" in part]


def _allowed(field: Schema) -> str:
    match field:
        case {"anyOf": parts}:
            text = " or ".join(map(_allowed, parts))
        case {"enum": values}:
            text = ", ".join(f"`{json.dumps(value)}`" for value in values)
        case {"type": "boolean"}:
            text = "`true`, `false`"
        case {"type": "array", "prefixItems": parts}:
            text = f"[{', '.join(map(_allowed, parts))}]"
        case {"type": "array", "items": item}:
            text = f"list of {_allowed(item)}"
        case {"type": "object", "propertyNames": {"enum": names}, "additionalProperties": value}:
            text = f"table of {', '.join(f'`{name}`' for name in names)}: {_allowed(value)}"
        case {"type": kind}:
            stated = {b: sign for b, sign in _BOUNDS if b in field and abs(field[b]) < _ANY}
            bounds = ", ".join(f"{sign} {field[b]:,.15g}" for b, sign in stated.items())
            like = f"like `{field['pattern']}`" if "pattern" in field else ""
            text = " ".join(part for part in (_KINDS[kind], bounds, like) if part)
        case _:
            raise ValueError(f"a kind of field that is not foreseen: {field}")
    return text


def _shown(default: object) -> str:
    if default is None or default == "":
        return "none"
    return f"`{json.dumps(default, ensure_ascii=False)}`"
