"""Configuration of feed-forward, of valves and of axes."""

from collections.abc import Collection
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from valvemap.config.sections import Section, rising
from valvemap.pipeline.units import Scaling

Percent = Annotated[float, Field(ge=0.0, le=100.0)]
SignedPercent = Annotated[float, Field(ge=-100.0, le=100.0)]


class FeedForwardConfig(Section):
    """How the answer to a demand is written to ``nodes.required_U``, once an operator has armed it.

    It is written while the newest sample is fresh and good, the map is identified and the answer
    within reach, range and certainty; otherwise the fallback acts.
    """

    range_percent: Annotated[tuple[Percent, Percent], AfterValidator(rising)] = Field(
        (0.0, 100.0), description="lowest and highest U that is ever written"
    )
    slew_percent_per_s: float = Field(
        100.0, gt=0.0, le=10_000.0, description="fastest change of U that is written"
    )
    fallback: Literal["hold", "ramp", "hand_back"] = Field(
        "hold",
        description="hold: keep the last U; ramp: go to fallback_percent; hand_back: let the "
        "source take its own command",
    )
    fallback_percent: Percent = Field(0.0, description="U that the ramp goes to")
    max_age_s: float = Field(
        0.5,
        ge=0.01,
        le=60.0,
        description="greatest age of the sample used, by arrival and by the clocks",
    )
    max_width_percent: float = Field(
        10.0, gt=0.0, le=100.0, description="widest 95 % interval of U"
    )
    lead: bool = Field(
        default=False,
        description="advance the demand, by its own slope, by the identified delay of the spool",
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        low, high = self.range_percent
        if self.fallback == "ramp" and not low <= self.fallback_percent <= high:
            raise ValueError(
                f"fallback_percent = {self.fallback_percent:g}: must be within range_percent = "
                f"{[low, high]}"
            )
        return self


class AxisFeedForwardConfig(FeedForwardConfig):
    """The same of an axis: U has both signs."""

    range_percent: Annotated[tuple[SignedPercent, SignedPercent], AfterValidator(rising)] = Field(
        (-100.0, 100.0), description="lowest and highest U that is ever written"
    )
    fallback_percent: SignedPercent = Field(0.0, description="U that the ramp goes to")


def check_feed_forward(
    given: FeedForwardConfig, *, is_given: bool, is_written: bool, has_heartbeat: bool
) -> None:
    """Check the settings against the nodes there are.

    Raises
    ------
    ValueError
        naming the node that is missing.
    """
    if is_given and not is_written:
        raise ValueError("feed_forward: nodes.required_U is needed; nothing is written without")
    if given.fallback == "hand_back" and not has_heartbeat:
        raise ValueError(
            "feed_forward.fallback = 'hand_back': nodes.heartbeat is needed; the source would "
            "not know"
        )


def check_command_unit(U: Scaling, said: Collection[str], *, is_written: bool) -> None:
    """Check that it is known in what the command is written; ``said`` are its given settings.

    Raises
    ------
    ValueError
        if U does not come in % and the command's unit is not given.
    """
    if is_written and not U.is_identity and not {"unit", "raw"} & set(said):
        raise ValueError(
            "signals.required_U: unit, or raw and range, must say in what the command is "
            'written, because U does not come in %; unit = "%" where it does'
        )
