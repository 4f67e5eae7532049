"""A saved model as JSON: its schema, and the conversion of a map to the document and back.

All values are in physical units and full precision: a loaded model predicts bit-identically.
"""

from typing import Annotated, Final, Literal, assert_never

import numpy as np
from pydantic import Field, model_validator

from valvemap.model.drift_states import moving_by_logarithm
from valvemap.model.kernels import lack_of_fit
from valvemap.model.kernels.flow_path import OF_MAP
from valvemap.model.kernels.support import PLACES_OF_CELL, T_LOW
from valvemap.model.linear_map import LinearParameters
from valvemap.model.portable_flow_map import FIRST_SCALARS, MOVING, SCALARS, GaussianMap
from valvemap.model.portable_map import PortableMap
from valvemap.model.rbf_network import NetworkMap
from valvemap.model.residual_spread import EDGES_DP, EDGES_U
from valvemap.model.samples import Floats, Singles
from valvemap.model.support import Support
from valvemap.storage.structure_document import (
    Numbers,
    Section,
    StructureSection,
    fewest_parameters,
    structure_of,
    structure_section,
)

VERSION: Final = 2
MOST_RANGE: Final = 1e4  # % or bar
UNITS: Final = {"U": "%", "dp": "bar", "s": "√bar", "Q": "l/min", "T": "°C"}

Rows = tuple[Numbers, ...]


class LinearSection(Section):
    """A structure, theta and its covariance."""

    kind: Literal["linear"] = "linear"
    structure: StructureSection
    theta: Numbers
    covariance: Rows

    @model_validator(mode="after")
    def _sizes_fit(self) -> "LinearSection":
        if (least := fewest_parameters(self.structure)) > len(self.theta):
            raise ValueError(f"theta has {len(self.theta)} numbers; {least} or more are allowed")
        n = len(structure_of(self.structure).parameter_names)
        if len(self.theta) != n:
            raise ValueError(f"theta has {len(self.theta)} numbers; {n} are allowed")
        if [len(row) for row in self.covariance] != [n] * n:
            raise ValueError(f"covariance: {n} rows of {n} numbers are allowed")
        return self


class NetworkSection(Section):
    """The paper's network: weights, centres and log-widths of its neurons, normalised."""

    kind: Literal["network"] = "network"
    grid: tuple[int, int]
    U_range: tuple[float, float]
    dp_range: tuple[float, float]
    Q_scale: float
    w: Numbers
    c: tuple[tuple[float, float], ...]
    log_b: Numbers
    monitor: Numbers

    @model_validator(mode="after")
    def _sizes_fit(self) -> "NetworkSection":
        m = self.grid[0] * self.grid[1]
        for name in ("w", "c", "log_b"):
            if len(getattr(self, name)) != m:
                raise ValueError(f"{name} has {len(getattr(self, name))} rows; {m} are allowed")
        return self


class GaussianSection(Section):
    """The map of `Auto`, see :class:`~valvemap.model.portable_flow_map.GaussianMap`.

    Effects of temperature are of ``viscosity``, as √ν - 1 and ν - 1 had them up to 0.2.0, or of its
    ``logarithm``, as `kernels.flow_oil` has them.
    """

    kind: Literal["gaussian"] = "gaussian"
    effects_of: Literal["viscosity", "logarithm"] = "viscosity"
    U_range: tuple[float, float]
    dp_range: tuple[float, float]
    theta: Numbers
    std: Numbers
    moving: tuple[Rows, Rows]
    scalars: Numbers = Field(min_length=FIRST_SCALARS, max_length=len(SCALARS))
    temperatures: tuple[float | None, float | None]
    operators: Numbers = Field(min_length=OF_MAP, max_length=OF_MAP)
    play: tuple[float, float]

    @model_validator(mode="after")
    def _sizes_fit(self) -> "GaussianSection":
        for name in ("U_range", "dp_range"):
            low, high = getattr(self, name)
            if not -MOST_RANGE <= low < high <= MOST_RANGE:
                raise ValueError(
                    f"{name}: two ascending numbers within ±{MOST_RANGE:g} are allowed"
                )
        sides = [[len(row) for row in side] for side in self.moving]
        if sides != [[MOVING[2]] * MOVING[1]] * MOVING[0]:
            raise ValueError(f"moving: {MOVING[0]} x {MOVING[1]} rows of {MOVING[2]} are allowed")
        return self


MapSection = Annotated[
    LinearSection | NetworkSection | GaussianSection, Field(discriminator="kind")
]


class RegionSection(Section):
    """Where there were samples: edges of the cells over U (%) and dp (bar), and their weights."""

    U: Numbers
    dp: Numbers
    samples: Rows

    @model_validator(mode="after")
    def _sizes_fit(self) -> "RegionSection":
        sizes = len(self.samples), {len(row) for row in self.samples}
        if sizes != (len(EDGES_U) - 1, {len(EDGES_DP) - 1}):
            rows, columns = len(EDGES_U) - 1, len(EDGES_DP) - 1
            raise ValueError(f"samples: {rows} rows of {columns} numbers are allowed")
        return self


class SupportSection(Section):
    """Region of the map's samples, see :class:`~valvemap.model.support.Support`.

    ``boxes`` are rows: samples (255 at most), their range of U, dp and T, low and high each, and
    the widest gap in T; null where no temperature was measured. ``fit`` holds the sums behind the
    question whether eq. (7) suffices.
    """

    U_range: tuple[float, float]
    dp_range: tuple[float, float]
    Q_max: float = Field(gt=0.0)
    boxes: tuple[tuple[float | None, ...], ...]
    fit: Numbers = Field(min_length=lack_of_fit.PLACES, max_length=lack_of_fit.PLACES)

    @model_validator(mode="after")
    def _sizes_fit(self) -> "SupportSection":
        for name in ("U_range", "dp_range"):
            if not getattr(self, name)[0] < getattr(self, name)[1]:
                raise ValueError(f"{name}: two ascending numbers are allowed")
        for box in self.boxes:
            if len(box) != PLACES_OF_CELL or None in box[:T_LOW]:
                raise ValueError(f"boxes: rows of {PLACES_OF_CELL} numbers are allowed")
        return self


class ModelDocument(Section):
    """One valve's map as one estimator identified it."""

    format: Literal["valvemap-model"] = "valvemap-model"
    version: Literal[2] = 2
    valve: str
    estimator: str
    last_sample_ns: int
    units: dict[str, str]
    map: MapSection
    parameters: dict[str, float | None]
    std: dict[str, float | None]
    noise_std: Annotated[float, Field(ge=0.0)] | None
    temperature: float | None
    region: RegionSection
    support: SupportSection

    @model_validator(mode="after")
    def _units_are_ours(self) -> "ModelDocument":
        if self.units != UNITS:
            raise ValueError(f"units are {self.units}; {UNITS} is allowed")
        return self


def map_section(portable: PortableMap) -> MapSection:
    """Return the section of a map."""
    match portable:
        case LinearParameters(structure, theta, covariance):
            return LinearSection(
                structure=structure_section(structure),
                theta=_numbers(theta),
                covariance=_rows(covariance),
            )
        case NetworkMap():
            return NetworkSection(
                grid=portable.grid,
                U_range=portable.U_range,
                dp_range=portable.dp_range,
                Q_scale=portable.Q_scale,
                w=_numbers(portable.w),
                c=tuple((float(U), float(dp)) for U, dp in portable.c),
                log_b=_numbers(portable.log_b),
                monitor=_numbers(portable.monitor),
            )
        case GaussianMap():
            first, learnt = portable.temperatures.tolist()
            half, known = portable.play.tolist()
            return GaussianSection(
                effects_of="logarithm",
                U_range=portable.U_range,
                dp_range=portable.dp_range,
                theta=_numbers(portable.theta),
                std=_numbers(portable.std),
                moving=(_rows(portable.moving[0]), _rows(portable.moving[1])),
                scalars=_numbers(portable.scalars),
                temperatures=(_or_none(first), _or_none(learnt)),
                operators=_numbers(portable.operators),
                play=(half, known),
            )
        case _:
            assert_never(portable)


def map_of(section: MapSection) -> PortableMap:
    """Return the map of a section."""
    match section:
        case LinearSection():
            return LinearParameters(
                structure_of(section.structure),
                np.array(section.theta),
                np.array(section.covariance),
            )
        case NetworkSection():
            ranges = section.grid, section.U_range, section.dp_range, section.Q_scale
            w, c, log_b = (np.array(x, np.float64) for x in (section.w, section.c, section.log_b))
            return NetworkMap(*ranges, w, c, log_b, np.array(section.monitor))
        case GaussianSection():
            moving = np.array(section.moving)
            if section.effects_of == "viscosity":
                moving = moving_by_logarithm(moving)
            return GaussianMap(
                U_range=section.U_range,
                dp_range=section.dp_range,
                theta=np.array(section.theta, np.float32),
                std=np.array(section.std),
                moving=moving,
                scalars=np.pad(section.scalars, (0, len(SCALARS) - len(section.scalars))),
                temperatures=np.array(section.temperatures, np.float64),
                operators=np.array(section.operators),
                play=np.array(section.play),
            )


def region_section(weights: Floats) -> RegionSection:
    """Return the section of the region covered by samples."""
    return RegionSection(
        U=tuple(EDGES_U.tolist()), dp=tuple(EDGES_DP.tolist()), samples=_rows(weights)
    )


def support_section(support: Support) -> SupportSection:
    """Return the section of a map's support."""
    U_low, U_high, dp_low, dp_high, Q_max = support.ranges.tolist()
    boxes = [[None if np.isnan(x) else x for x in row] for row in support.boxes.tolist()]
    return SupportSection(
        U_range=(U_low, U_high),
        dp_range=(dp_low, dp_high),
        Q_max=Q_max,
        boxes=tuple(tuple(row) for row in boxes),
        fit=_numbers(support.fit),
    )


def support_of(section: SupportSection) -> Support:
    """Return the support from a section."""
    boxes = np.array(section.boxes, np.float64).reshape(-1, PLACES_OF_CELL)
    ranges = np.array([*section.U_range, *section.dp_range, section.Q_max])
    return Support.of_boxes(boxes, np.array(section.fit), ranges)


def _or_none(x: float) -> float | None:
    return None if np.isnan(x) else x


def _numbers(values: Floats | Singles) -> Numbers:
    return tuple(float(x) for x in values)


def _rows(table: Floats) -> Rows:
    return tuple(_numbers(row) for row in table)
