"""A saved model as JSON: its schema, and the conversion of a map to the document and back.

All values are in physical units and full precision: a loaded model predicts bit-identically.
"""

from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from valvemap.model.auto import Auto
from valvemap.model.auto_state import AutoState, write_map
from valvemap.model.estimator import Estimator
from valvemap.model.kernels import cells as auto_memory
from valvemap.model.kernels import lack_of_fit
from valvemap.model.kernels.support import PLACES_OF_CELL, T_LOW
from valvemap.model.kernels.surface import APART, BORDER, FIVE_TERMS
from valvemap.model.linear_map import LinearMap, LinearMapState
from valvemap.model.map_shapes import MOST, Shape
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import Polynomial, Structure, TensorSpline
from valvemap.model.monotone import Monotone
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.rbf_network import RbfNetwork, RbfNetworkState
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.residual_spread import EDGES_DP, EDGES_U
from valvemap.model.samples import Floats
from valvemap.model.support import Support

VERSION: Final = 2
BAND: Final = 31  # of `Auto`'s inverse information: a point's parameters lie no farther apart
UNITS: Final = {"U": "%", "dp": "bar", "s": "√bar", "Q": "l/min", "T": "°C"}

Numbers = tuple[float, ...]
Rows = tuple[Numbers, ...]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PolynomialSection(_Section):
    """Sums of products of powers, eq. (7) among them."""

    kind: Literal["polynomial"] = "polynomial"
    terms: tuple[str, ...]
    names: tuple[str, ...] = ()
    viscosity_40: float = 46.0
    viscosity_100: float = 6.8


class SplineSection(_Section):
    """Tensor product of cubic B-splines over U, s[, T]."""

    kind: Literal["spline"] = "spline"
    U: Numbers
    s: Numbers
    T: Numbers = ()
    dead_band: float | None = None
    saturation: float | None = None
    smoothness: float = 0.3
    at_rest: Literal["free", "zero"] = "free"


class RadialBasisSection(_Section):
    """Eq. (7) and a grid of Gaussians over U, s."""

    kind: Literal["radial_basis"] = "radial_basis"
    U: Numbers
    s: Numbers
    width: float = 1.0
    smoothness: float = 0.03


StructureSection = Annotated[
    PolynomialSection | SplineSection | RadialBasisSection, Field(discriminator="kind")
]


class LinearSection(_Section):
    """A structure, theta and its covariance."""

    kind: Literal["linear"] = "linear"
    structure: StructureSection
    theta: Numbers
    covariance: Rows

    @model_validator(mode="after")
    def _sizes_fit(self) -> "LinearSection":
        if (least := _fewest(self.structure)) > len(self.theta):
            raise ValueError(f"theta has {len(self.theta)} numbers; {least} or more are allowed")
        n = len(_structure(self.structure).parameter_names)
        if len(self.theta) != n:
            raise ValueError(f"theta has {len(self.theta)} numbers; {n} are allowed")
        if [len(row) for row in self.covariance] != [n] * n:
            raise ValueError(f"covariance: {n} rows of {n} numbers are allowed")
        return self


class NetworkSection(_Section):
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


class AutoSection(_Section):
    """The shape that `Auto` chose, its parameters, and the inverse information behind its std."""

    kind: Literal["auto"] = "auto"
    shape: tuple[float | None, ...] = Field(min_length=6, max_length=6)
    dp_top: float
    theta: Numbers
    beside: Numbers = Field(min_length=BORDER, max_length=BORDER)
    inverse: Rows
    mixed: Rows
    corner: Rows
    variance: float
    gain_variance: float = 0.0

    @model_validator(mode="after")
    def _sizes_fit(self) -> "AutoSection":
        n = _shape(self).size
        for name, rows, columns in (
            ("theta", n, None),
            ("inverse", n, BAND),
            ("mixed", n, BORDER),
            ("corner", BORDER, BORDER),
        ):
            table = getattr(self, name)
            if len(table) != rows or (columns and any(len(row) != columns for row in table)):
                raise ValueError(f"{name}: {rows} rows of {columns or 1} are allowed")
        return self


MapSection = Annotated[LinearSection | NetworkSection | AutoSection, Field(discriminator="kind")]


class RegionSection(_Section):
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


class SupportSection(_Section):
    """What the map rests on, see :class:`~valvemap.model.support.Support`.

    ``boxes`` are rows: samples (255 at most), what they span of U, dp and T, low and high each, and
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


class ModelDocument(_Section):
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
    noise_std: float | None
    temperature: float | None
    region: RegionSection
    support: SupportSection

    @model_validator(mode="after")
    def _units_are_ours(self) -> "ModelDocument":
        if self.units != UNITS:
            raise ValueError(f"units are {self.units}; {UNITS} is allowed")
        return self


def map_section(estimator: Estimator[Any], state: Any) -> MapSection:  # noqa: ANN401 - its own state
    """Return the section of an estimator's map.

    Raises
    ------
    ValueError
        if the map is not determined yet.
    """
    match estimator:
        case Auto():
            section: MapSection = _auto_section(state)
        case RbfNetwork():
            section = NetworkSection(
                grid=estimator.grid,
                U_range=estimator.U_range,
                dp_range=estimator.dp_range,
                Q_scale=estimator.Q_scale,
                w=_numbers(state.w),
                c=tuple((float(U), float(dp)) for U, dp in state.c),
                log_b=_numbers(state.log_b),
                monitor=_numbers(state.monitor),
            )
        case RecursiveLeastSquares() | Monotone() | MaximumLikelihood() | LinearMap():
            structure = estimator.structure
            n = len(structure.parameter_names)
            theta, _ = estimator.parameters(state)
            covariance = estimator.covariance(state)[:n, :n]
            if not np.isfinite(theta[:n]).all() or not np.isfinite(covariance).all():
                raise ValueError("its parameters are not determined yet")
            section = LinearSection(
                structure=_structure_section(structure),
                theta=_numbers(theta[:n]),
                covariance=_rows(covariance),
            )
        case _:
            raise ValueError(f"a {type(estimator).__name__} cannot be saved")
    return section


def map_of(section: MapSection) -> tuple[Estimator[Any], Any]:
    """Return the estimator and its state from a section."""
    match section:
        case LinearSection():
            theta, covariance = np.array(section.theta), np.array(section.covariance)
            return LinearMap(_structure(section.structure)), LinearMapState(theta, covariance)
        case NetworkSection():
            network = RbfNetwork(
                grid=section.grid,
                U_range=section.U_range,
                dp_range=section.dp_range,
                Q_scale=section.Q_scale,
            )
            w, c, log_b = (np.array(x, np.float64) for x in (section.w, section.c, section.log_b))
            still = np.zeros_like(w), np.zeros_like(c), np.zeros_like(log_b)
            noted = np.column_stack((w, c, np.exp(-2.0 * log_b)))
            monitor = np.array(section.monitor)
            return network, RbfNetworkState(w, c, log_b, *still, monitor, noted)
        case AutoSection():
            return Auto(), _auto_state(section)


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


def _structure_section(structure: Structure) -> StructureSection:
    match structure:
        case Polynomial():
            return PolynomialSection(
                terms=structure.terms,
                names=structure.names,
                viscosity_40=structure.viscosity_40,
                viscosity_100=structure.viscosity_100,
            )
        case TensorSpline():
            return SplineSection(
                U=structure.U,
                s=structure.s,
                T=structure.T,
                dead_band=structure.dead_band,
                saturation=structure.saturation,
                smoothness=structure.smoothness,
                at_rest=structure.at_rest,
            )
        case RadialBasis():
            return RadialBasisSection(
                U=structure.U,
                s=structure.s,
                width=structure.width,
                smoothness=structure.smoothness,
            )
        case _:
            raise ValueError(f"a {type(structure).__name__} cannot be saved")


def _structure(section: StructureSection) -> Structure:
    match section:
        case PolynomialSection():
            return Polynomial(**section.model_dump(exclude={"kind"}))
        case SplineSection():
            return TensorSpline(**section.model_dump(exclude={"kind"}))
        case RadialBasisSection():
            return RadialBasis(**section.model_dump(exclude={"kind"}))


def _fewest(section: StructureSection) -> int:
    """Return a lower bound of the number of parameters, without building the structure."""
    match section:
        case PolynomialSection():
            return 1
        case SplineSection():
            return len(section.U) * len(section.s) * max(1, len(section.T))
        case RadialBasisSection():
            return len(section.U) * len(section.s)


def _auto_section(state: AutoState) -> AutoSection:
    if not state.counters[auto_memory.FITTED]:
        raise ValueError("its map is not determined yet")
    shape = Shape.from_array(state.shapes[0])
    theta, n = state.theta, shape.size
    return AutoSection(
        shape=tuple(None if np.isnan(x) else float(x) for x in state.shapes[0]),
        dp_top=float(state.top[0]),
        theta=_numbers(theta[:n]),
        beside=_numbers(theta[MOST:]),
        inverse=_rows(_band(state)[:n]),
        mixed=_rows(np.pad(state.mixed[:n].astype(np.float64), ((0, 0), (FIVE_TERMS, 0)))),
        corner=_rows(state.corner),
        variance=float(state.scalars[auto_memory.VARIANCE]),
        gain_variance=float(state.scalars[auto_memory.GAIN_VARIANCE]),
    )


def _auto_state(section: AutoSection) -> AutoState:
    blank = Auto().initial_state()
    n = _shape(section).size
    shape = np.array([np.nan if x is None else x for x in section.shape])
    blank.theta[:n], blank.theta[MOST:] = section.theta, section.beside
    blank.mixed[:n] = np.reshape(section.mixed, (n, BORDER))[:, FIVE_TERMS:]
    blank.corner[:] = section.corner
    blank.shapes[:], blank.top[:] = shape, section.dp_top
    blank.scalars[auto_memory.VARIANCE] = section.variance
    blank.scalars[auto_memory.GAIN_VARIANCE] = section.gain_variance
    blank.counters[auto_memory.FITTED] = 1
    theta = np.concatenate([section.theta, section.beside])
    for which in (0, 1):
        write_map(blank, which, _shape(section), theta, section.dp_top)
    kept, filed = _pairs(int(blank.sizes[0, 1]))
    blank.inverse[:n, kept] = np.reshape(section.inverse, (n, BAND))[:, filed]
    return blank


def _band(state: AutoState) -> Floats:
    """Return the inverse information in the file's form: bands by distance of two parameters."""
    found = np.zeros((MOST, BAND))
    kept, filed = _pairs(int(state.sizes[0, 1]))
    found[:, filed] = state.inverse[:, kept]
    return found


def _pairs(n_s: int) -> tuple[list[int], list[int]]:
    """Return the indices of parameter pairs in memory and in a file; ``n_s`` is the size per U."""
    apart = [(u, v) for u in range(4) for v in range(-3, 4) if u or v >= 0]
    return [u * APART + v for u, v in apart], [u * n_s + v for u, v in apart]


def _shape(section: AutoSection) -> Shape:
    return Shape.from_array(np.array([np.nan if x is None else x for x in section.shape]))


def _numbers(values: Floats) -> Numbers:
    return tuple(float(x) for x in values)


def _rows(table: Floats) -> Rows:
    return tuple(_numbers(row) for row in table)
