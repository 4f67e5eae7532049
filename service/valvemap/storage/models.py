"""Models on disk: a self-contained map as one JSON file."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from valvemap.errors import ConfigurationError, NoSuchFile, StorageError
from valvemap.model.estimator import Estimator
from valvemap.model.portable_map import restored, to_map
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Floats
from valvemap.model.support import Support
from valvemap.owned_files import write_whole
from valvemap.storage.model_document import (
    UNITS,
    ModelDocument,
    map_of,
    map_section,
    region_section,
    support_of,
    support_section,
)

MOST_BYTES: Final = 64_000_000  # of a model file; a map of 1,000 parameters has 20 MB
MOST_SHOWN: Final = 60  # characters of a value in a message
DEEPEST: Final = 8  # nesting of lists and objects; a model has 4


@dataclass(frozen=True, repr=False, eq=False)
class StoredModel:
    """One valve's map as one estimator identified it.

    Attributes
    ----------
    valve, name
        Names of the valve and of the estimator.
    estimator, state
        Predict and invert bit-identically to the estimator that was saved.
    noise_std
        Standard deviation of a measurement about the map, l/min; NaN if unknown.
    T
        Oil temperature measured last, °C; NaN if unknown.
    t
        Source time of the last sample, UTC ns; 0 before the first.
    samples : (10, 12)
        Recent samples in each cell over U and √dp: the covered region.
    support
        The samples that support the map: outside them `invert` returns EXTRAPOLATING.
    """

    valve: str
    name: str
    estimator: Estimator[Any]
    state: Any
    noise_std: float
    T: float
    t: int
    samples: Floats
    support: Support


def save_model(
    file: Path,
    valve: str,
    name: str,
    estimator: Estimator[Any],
    state: Any,  # noqa: ANN401 - the estimator's own
    spread: ResidualSpread,
    support: Support,
    t: int = 0,
    T: float = np.nan,
) -> None:
    """Write a model.

    Raises
    ------
    StorageError
        if the file cannot be written, or the map is not determined yet; names file or estimator.
    """
    found = StoredModel(
        valve=valve,
        name=name,
        estimator=estimator,
        state=state,
        noise_std=spread.noise_std,
        T=T,
        t=t,
        samples=spread.weights,
        support=support,
    )
    write_model(file, found)


def write_model(file: Path, model: StoredModel) -> None:
    """Write a model; see :func:`save_model`."""
    try:
        section = map_section(to_map(model.estimator, model.state))
    except ValueError as error:
        raise StorageError(f"{file}: {model.valve}.{model.name} is not saved: {error}") from None
    theta, std = model.estimator.parameters(model.state)
    names = model.estimator.parameter_names
    document = ModelDocument(
        valve=model.valve,
        estimator=model.name,
        last_sample_ns=model.t,
        units=UNITS,
        map=section,
        parameters=dict(zip(names, map(_or_none, theta.tolist()), strict=True)),
        std=dict(zip(names, map(_or_none, std.tolist()), strict=True)),
        noise_std=_or_none(model.noise_std),
        temperature=_or_none(model.T),
        region=region_section(model.samples),
        support=support_section(model.support),
    )
    text = json.dumps(document.model_dump(mode="json"), ensure_ascii=False, indent=1)
    write_whole(file, text + "\n")


def load_model(file: Path) -> StoredModel:
    """Read a model.

    Raises
    ------
    StorageError
        if the model is invalid; one line with file, field, value and the allowed values.
    """
    try:
        return _model_of(ModelDocument.model_validate(_content(file)))
    except FileNotFoundError:
        raise NoSuchFile(f"{file}: no such file") from None
    except OSError as error:
        raise StorageError(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except ValidationError as error:
        raise StorageError(f"{file}: {_first(error)}") from None
    except (ConfigurationError, ValueError, OverflowError) as error:
        raise StorageError(f"{file}: map: {error}") from None


def _model_of(document: ModelDocument) -> StoredModel:
    estimator, state = restored(map_of(document.map))
    return StoredModel(
        valve=document.valve,
        name=document.estimator,
        estimator=estimator,
        state=state,
        noise_std=_or_nan(document.noise_std),
        T=_or_nan(document.temperature),
        t=document.last_sample_ns,
        samples=np.array(document.region.samples),
        support=support_of(document.support),
    )


def _content(file: Path) -> object:
    """Return the file's content, with limits on size and depth."""
    with file.open("rb") as opened:
        read = opened.read(MOST_BYTES + 1)
    if len(read) > MOST_BYTES:
        allowed = f"up to {MOST_BYTES // 1_000_000} MB are allowed"
        raise StorageError(f"{file}: it is too large; {allowed}")
    try:
        content: object = json.loads(read.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise StorageError(f"{file}: not a text file in UTF-8; save it so") from None
    except RecursionError:
        raise StorageError(f"{file}: nested too deep; {DEEPEST} levels are allowed") from None
    except ValueError as error:
        raise StorageError(f"{file}: not JSON: {error}") from None
    if _depth(content) > DEEPEST:
        raise StorageError(f"{file}: nested too deep; {DEEPEST} levels are allowed")
    return content


def _depth(content: object) -> int:
    """Return the nesting of lists and objects; stops one level above the limit."""
    level, depth = [content], 0
    while depth <= DEEPEST:
        level = [
            inner
            for outer in level
            if isinstance(outer, list | dict)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if not level:
            break
        depth += 1
    return depth


def is_model(file: Path) -> bool:
    """Whether the file has the suffix of a model."""
    return file.suffix.lower() == ".json"


def _first(error: ValidationError) -> str:
    details = error.errors()[0]
    tags = {"linear", "network", "gaussian", "polynomial", "spline", "radial_basis"}
    field = ".".join(str(key) for key in details["loc"] if key not in tags)
    if details["type"] == "union_tag_invalid" and details["ctx"]["tag"] == "auto":
        return f"{field}: it is of the former Auto; identify it again: valvemap replay --save FILE"
    message = details["msg"].removeprefix("Value error, ").replace("\n", " ")
    if isinstance(details["input"], str | int | float):
        message += f", not {repr(details['input'])[:MOST_SHOWN]}"
    return f"{field}: {message}" if field else message


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
