"""Configuration of the estimators, a class per kind, and the function that builds them."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Final, Literal, assert_never, get_args

from pydantic import BaseModel, Field, ValidationInfo, field_validator

from valvemap.config.names import NAME
from valvemap.config.sections import Range, Section
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Forgetting,
    Resetting,
    SlidingWindow,
    Subspace,
    Variable,
)
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares

Name = Annotated[
    str,
    Field(pattern=NAME, description="its name in each node id"),
]
Lam = Annotated[float, Field(gt=0.0, le=1.0, description="forgetting factor")]
DEFAULT_LAM = 0.998


ForgettingRule = Literal[
    "adaptive", "exponential", "directional", "subspace", "resetting", "variable", "window"
]


class EstimatorSection(Section):
    """Base of the sections of estimators; each has a ``kind`` and a ``name``."""

    any_U_range: ClassVar[bool] = False  # whether its map covers any range of U, not 0 … 100 % only


class RlsConfig(EstimatorSection):
    """Recursive least squares on eq. (7)."""

    kind: Literal["RLS"] = "RLS"
    name: Name = "RLS"
    forgetting: ForgettingRule = Field(
        "adaptive", description="adaptive: as fast as drift is found, and at once after a change"
    )
    lam: Lam | None = Field(
        None, description="forgetting factor; by default 1 of adaptive, else 0.998"
    )
    window_samples: int = Field(500, ge=10, le=100_000, description="length of a window")

    @field_validator("lam")
    @classmethod
    def _determines(cls, lam: float | None, info: ValidationInfo) -> float | None:
        rule = _RULES.get(info.data.get("forgetting", ""))  # None for a window
        if lam is not None and rule is not None:
            RecursiveLeastSquares(forgetting=rule(lam))
        return lam


class RmlConfig(EstimatorSection):
    """Recursive maximum likelihood on eq. (7), noise coloured by a moving average."""

    kind: Literal["RML"] = "RML"
    name: Name = "RML"
    lam: Lam = 0.999
    nd: int = Field(1, ge=1, le=8, description="order of the moving average of the noise")

    @field_validator("lam")
    @classmethod
    def _determines(cls, lam: float) -> float:
        return MaximumLikelihood(lam=lam).lam


class RbfConfig(EstimatorSection):
    """The paper's radial basis function network, trained by gradient descent."""

    any_U_range: ClassVar[bool] = True

    kind: Literal["RBF"] = "RBF"
    name: Name = "RBF"
    neurons_U: int = Field(5, ge=2, le=30, description="neurons along U")
    neurons_dp: int = Field(5, ge=2, le=30, description="neurons along the pressure drop")
    eta: float = Field(0.3, gt=0.0, le=1.0, description="learning rate")
    alpha: float = Field(0.1, ge=0.0, lt=1.0, description="momentum")


class AutoConfig(EstimatorSection):
    """The map as one Gaussian model, all of whose scales the samples decide."""

    any_U_range: ClassVar[bool] = True

    kind: Literal["Auto"] = "Auto"
    name: Name = "Auto"
    lam: Lam = Field(0.998, description="forgetting factor of a cell of the map")

    @field_validator("lam")
    @classmethod
    def _determines(cls, lam: float) -> float:
        return FlowMap(lam=lam).lam


AnyEstimatorConfig = RlsConfig | RmlConfig | RbfConfig | AutoConfig
EstimatorConfig = Annotated[AnyEstimatorConfig, Field(discriminator="kind")]


def kind_of(section: type[BaseModel]) -> str | None:
    """Return the kind of a class of sections, None if it has none."""
    field = section.model_fields.get("kind")
    return None if field is None else str(field.default)


SECTIONS: Final = {str(kind_of(section)): section for section in get_args(AnyEstimatorConfig)}
KINDS: Final = tuple(SECTIONS)
FORMER_KINDS: Final = {"FlowMap": "Auto"}  # by the name that replaced it
FORMER_FIELDS: Final = {  # by the remedy
    "lag_U_s": "Auto finds it: remove this line",
    "lag_Q_s": "Auto finds it: remove this line",
}


def default_estimators() -> tuple[AnyEstimatorConfig, ...]:
    """Return the paper's three methods and `Auto`."""
    return RlsConfig(), RmlConfig(), RbfConfig(), AutoConfig()


def build_estimator(
    config: AnyEstimatorConfig, U_range: Range, dp_range: Range, Q_range: Range
) -> Estimator[Any]:
    """Return the estimator of a section, for a valve with the given ranges."""
    match config:
        case RlsConfig():
            return RecursiveLeastSquares(forgetting=_forgetting(config))
        case RmlConfig():
            return MaximumLikelihood(nd=config.nd, lam=config.lam)
        case RbfConfig():
            return RbfNetwork(
                grid=(config.neurons_U, config.neurons_dp),
                eta=config.eta,
                alpha=config.alpha,
                U_range=U_range,
                dp_range=dp_range,
                Q_scale=max(abs(Q_range[0]), abs(Q_range[1])),
            )
        case AutoConfig():
            return FlowMap(U_range=U_range, dp_range=dp_range, lam=config.lam)
        case _:
            assert_never(config)


def _forgetting(config: RlsConfig) -> Forgetting:
    if config.forgetting == "window":
        return SlidingWindow(config.window_samples)
    if config.forgetting == "adaptive" and config.lam is None:
        return Adaptive()
    return _RULES[config.forgetting](DEFAULT_LAM if config.lam is None else config.lam)


_RULES: Mapping[str, Callable[[float], Forgetting]] = {
    "adaptive": Adaptive,
    "exponential": Exponential,
    "directional": Directional,
    "subspace": Subspace,
    "resetting": Resetting,
    "variable": Variable,
}
