"""Optional capabilities of estimators, as protocols; every estimator has `Estimator`.

Code outside of the model asks for a capability, never for a class: a new estimator gets nodes,
diagnostics and files by having the methods.

| capability | of estimators that |
|---|---|
| `LinearInParameters` | are linear in the parameters of a structure |
| `Informed` | also have the information matrix of these parameters |
| `Forgetful` | have a forgetting factor |
| `FindsChanges` | detect abrupt changes of the plant |
| `FindsLags` | estimate the lags of the signals |
| `Censors` | leave out samples that the meter does not show |
| `Restarts` | may restart their map |
| `ChoosesStructure` | select the structure of the map from the samples |
| `PathDependent` | have hysteresis |
| `Invertible` | have an exact inverse |
| `InPieces` | know the form of their map, so that its tables have certified errors |
| `ResidualStd` | take their standard deviation from the residuals |
| `MeasuresNoise` | separate the meter's noise from errors of the map |
| `FindsCauses` | weigh causes of what the samples show |
| `Portable` | can write their map to a file |
| `ManyModels` of :mod:`~valvemap.model.fleet` | update many models in one call |
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self, runtime_checkable

from valvemap.model.change import Change
from valvemap.model.model_structures import Structure
from valvemap.model.protocol_checks import CheckedByClass
from valvemap.model.samples import Codes, Floats, Times
from valvemap.vocabulary.findings import Finding

if TYPE_CHECKING:
    from valvemap.model.map_forms import MapForm
    from valvemap.model.portable_map import PortableMap


@runtime_checkable
class LinearInParameters(Protocol, metaclass=CheckedByClass):
    """An estimator of a structure's parameters: each is published by name."""

    @property
    def structure(self) -> Structure:
        """The map's structure, n parameters."""


@runtime_checkable
class Informed(LinearInParameters, Protocol, metaclass=CheckedByClass):
    """An estimator that also has the information about its parameters."""

    def information(self, state: Any) -> Floats:  # noqa: ANN401 - the estimator's own
        """Return P⁻¹ (n, n), in samples' X·Xᵀ; singular while a direction is not determined."""


@runtime_checkable
class Forgetful(Protocol, metaclass=CheckedByClass):
    """An estimator with a forgetting factor."""

    @property
    def lam(self) -> float:
        """The forgetting factor, 0 < lam <= 1."""

    def with_forgetting(self, lam: float) -> Self:
        """Return a copy with another forgetting factor; its states are compatible."""


@runtime_checkable
class FindsChanges(Protocol, metaclass=CheckedByClass):
    """An estimator with detection of abrupt plant changes, if its settings enable it."""

    @property
    def finds_changes(self) -> bool:
        """Whether the settings enable the detection."""

    def change_counts(self, states: Any) -> Times:  # noqa: ANN401 - its own states
        """Return the number of changes of each of M plants (M,)."""

    def last_change(self, state: Any) -> Change | None:  # noqa: ANN401 - its own state
        """Return the last detected change of one plant, None if there was none."""


@runtime_checkable
class FindsLags(Protocol, metaclass=CheckedByClass):
    """An estimator that estimates how U and Q lag."""

    def lags_many(self, states: Any, chosen: Times) -> Sequence[tuple[float, float]]:  # noqa: ANN401
        """Return the first-order lags of U and Q of the chosen models, s."""

    def largest_lags(self, states: Any) -> Floats:  # noqa: ANN401
        """Return the largest lag or dead time of each of M models, s (M,)."""


@runtime_checkable
class Censors(Protocol, metaclass=CheckedByClass):
    """An estimator that leaves out samples whose flow the meter cannot show."""

    def censored(self, states: Any) -> Times:  # noqa: ANN401 - its own states
        """Return the number of such samples of each of M models (M,)."""


@runtime_checkable
class Restarts(Protocol, metaclass=CheckedByClass):
    """An estimator that restarts its map, for example when it finds other lags."""

    def began(self, states: Any) -> Times:  # noqa: ANN401
        """Return the sample count of each of M models at its last restart; 0 if there was none."""

    def samples_since(self, states: Any) -> Times:  # noqa: ANN401
        """Return the number of samples of each of M models since its last restart."""


@runtime_checkable
class ChoosesStructure(Protocol, metaclass=CheckedByClass):
    """An estimator that selects its structure from the samples."""

    def structure_now(self, state: Any) -> Structure | None:  # noqa: ANN401 - its own state
        """Return the current structure; None if it is valid only where samples were."""

    def describe_many(self, states: Any, chosen: Times) -> Sequence[str]:  # noqa: ANN401
        """Return descriptions of the current structures of the chosen models."""


@runtime_checkable
class FitsInBursts(Protocol, metaclass=CheckedByClass):
    """An estimator that fits a map in some updates: for seconds, if kernels run interpreted."""

    fits_in_bursts: ClassVar[bool]


@runtime_checkable
class UsesTemperature(Protocol, metaclass=CheckedByClass):
    """An estimator whose map may depend on the oil temperature."""

    @property
    def uses_temperature(self) -> bool:
        """Whether its structure reads T."""


@runtime_checkable
class PathDependent(Protocol, metaclass=CheckedByClass):
    """An estimator whose flow depends on the direction of U (hysteresis)."""

    def follows(self, state: Any) -> bool:  # noqa: ANN401 - the estimator's state
        """Whether the flow depends on earlier samples, too: on play, a lag or a dead time."""

    def half_play(self, state: Any) -> float:  # noqa: ANN401 - the estimator's state
        """By how much U from below or above differs from U in the middle, %."""

    def directions(self, state: Any, U: Floats) -> Floats:  # noqa: ANN401 - the estimator's state
        """Direction of U (N,) along a path without a previous U."""

    def predict_along(
        self,
        state: Any,  # noqa: ANN401
        U: Floats,
        dp: Floats,
        T: Floats,
        direction: Floats,
    ) -> tuple[Floats, Floats]:
        """Flow and standard deviation, l/min, at N points of given directions."""

    def approached(self, state: Any, U: Floats) -> Floats:  # noqa: ANN401
        """U (N,) that moves the valve from its present position to the one that ``U`` holds."""


@runtime_checkable
class Invertible(Protocol, metaclass=CheckedByClass):
    """An estimator with an exact inverse."""

    def inverted(
        self,
        state: Any,  # noqa: ANN401
        Q: Floats,
        dp: Floats,
        T: Floats,
    ) -> tuple[Floats, Floats, Floats, Codes]:
        """Return U, U without its bounds, dQ/dU and the `InverseStatus`, all (N,)."""


@runtime_checkable
class InPieces(Protocol, metaclass=CheckedByClass):
    """An estimator that knows where its map is smooth; structures are known without it."""

    def form(self, state: Any, T: float) -> "MapForm | None":  # noqa: ANN401 - its own state
        """Return the form at one temperature; None before there is a map."""


@runtime_checkable
class ResidualStd(Protocol, metaclass=CheckedByClass):
    """An estimator whose standard deviation is that of its residuals, misfit and noise together."""

    std_of_residuals: ClassVar[Literal[True]]


@runtime_checkable
class MeasuresNoise(Protocol, metaclass=CheckedByClass):
    """An estimator that separates the noise of the flow meter from errors of its map."""

    def noise_std(self, state: Any) -> float:  # noqa: ANN401 - its own state
        """Return the standard deviation of the noise, l/min."""


@runtime_checkable
class FindsCauses(Protocol, metaclass=CheckedByClass):
    """An estimator that weighs causes of what the samples show."""

    def findings(self, state: Any) -> tuple[Finding, ...]:  # noqa: ANN401 - its own state
        """Return the likely causes, the likeliest first."""


@runtime_checkable
class Portable(Protocol, metaclass=CheckedByClass):
    """An estimator that can write its map to a file."""

    def to_map(self, state: Any) -> "PortableMap":  # noqa: ANN401
        """Return the map.

        Raises
        ------
        ValueError
            if it is not determined yet.
        """


def finds_changes(estimator: object) -> bool:
    """Whether an estimator detects and reports abrupt changes of the plant."""
    return isinstance(estimator, FindsChanges) and estimator.finds_changes
