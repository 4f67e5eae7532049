"""The structure of a saved linear map as JSON: its schema, and the conversion both ways."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from valvemap.model.model_structures import Polynomial, Structure
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.tensor_spline import TensorSpline

Numbers = tuple[float, ...]


class Section(BaseModel):
    """A part of a document: nothing else is allowed in it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PolynomialSection(Section):
    """Sums of products of powers, eq. (7) among them."""

    kind: Literal["polynomial"] = "polynomial"
    terms: tuple[str, ...]
    names: tuple[str, ...] = ()
    viscosity_40: float = 46.0
    viscosity_100: float = 6.8


class SplineSection(Section):
    """Tensor product of cubic B-splines over U, s[, T]."""

    kind: Literal["spline"] = "spline"
    U: Numbers
    s: Numbers
    T: Numbers = ()
    dead_band: float | None = None
    saturation: float | None = None
    smoothness: float = 0.3
    at_rest: Literal["free", "zero"] = "free"


class RadialBasisSection(Section):
    """Eq. (7) and a grid of Gaussians over U, s."""

    kind: Literal["radial_basis"] = "radial_basis"
    U: Numbers
    s: Numbers
    width: float = 1.0
    smoothness: float = 0.03


StructureSection = Annotated[
    PolynomialSection | SplineSection | RadialBasisSection, Field(discriminator="kind")
]


def structure_section(structure: Structure) -> StructureSection:
    """Return the section of a structure.

    Raises
    ------
    ValueError
        if it cannot be saved.
    """
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


def structure_of(section: StructureSection) -> Structure:
    """Return the structure of a section."""
    match section:
        case PolynomialSection():
            return Polynomial(**section.model_dump(exclude={"kind"}))
        case SplineSection():
            return TensorSpline(**section.model_dump(exclude={"kind"}))
        case RadialBasisSection():
            return RadialBasis(**section.model_dump(exclude={"kind"}))


def fewest_parameters(section: StructureSection) -> int:
    """Return a lower bound of the number of parameters, without building the structure."""
    match section:
        case PolynomialSection():
            return 1
        case SplineSection():
            return len(section.U) * len(section.s) * max(1, len(section.T))
        case RadialBasisSection():
            return len(section.U) * len(section.s)
