"""The section of a valve's commissioning: what `valvemap commission` may do to the plant."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from valvemap.config.sections import Section

Range = tuple[float, float]
Percent = Annotated[float, Field(ge=-100.0, le=100.0)]


class CommissionConfig(Section):
    """How `valvemap commission` drives the valve: U is written to ``nodes.required_U``.

    Every command is within range and slew. Beyond a limit of p1, p2 or Q, U retreats towards
    ``safe_percent``; above ``p_most_bar`` the run ends.
    """

    range_percent: tuple[Percent, Percent] | None = Field(
        None, description="lowest and highest U that is written; none = U_range_percent"
    )
    slew_percent_per_s: float = Field(
        400.0, gt=0.0, le=10_000.0, description="fastest change of U that is written"
    )
    safe_percent: Percent = Field(0.0, description="U that the valve returns to")
    period_s: float = Field(
        4.0, ge=0.5, le=600.0, description="time of U from end to end of its range and back"
    )
    sweep_s: float = Field(
        24.0, ge=1.0, le=3_600.0, description="length of the sweep before the refinement"
    )
    most_s: float = Field(60.0, ge=1.0, le=3_600.0, description="length of the whole run")
    p1_range_bar: Range | None = Field(None, description="p1 beyond which U retreats; none: any")
    p2_range_bar: Range | None = Field(None, description="p2 beyond which U retreats; none: any")
    Q_range_l_min: Range | None = Field(None, description="Q beyond which U retreats; none: any")
    p_most_bar: float | None = Field(
        None, gt=0.0, description="pressure above which the run ends; none: any"
    )
    max_age_s: float = Field(
        0.15, ge=0.05, le=5.0, description="age of the newest sample above which the run pauses"
    )
    operator_s: float = Field(
        1.0, ge=0.1, le=60.0, description="time without the operator's terminal that ends the run"
    )
    outage_s: float = Field(60.0, ge=0.0, le=3_600.0, description="pause after which the run ends")
    follow_s: float = Field(
        0.5, ge=0.05, le=10.0, description="longest delay of the measured U behind its command"
    )
    follow_percent: float = Field(
        3.0, gt=0.0, le=50.0, description="distance of U from its command that is accepted"
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for name in ("range_percent", "p1_range_bar", "p2_range_bar", "Q_range_l_min"):
            bounds = getattr(self, name)
            if bounds is not None and not bounds[0] < bounds[1]:
                raise ValueError(f"{name} = {list(bounds)}: the first must be below the second")
        bounds = self.range_percent
        if bounds is not None and not bounds[0] <= self.safe_percent <= bounds[1]:
            raise ValueError(
                f"safe_percent = {self.safe_percent:g}: must be within range_percent = "
                f"{list(bounds)}"
            )
        if self.sweep_s > self.most_s:
            raise ValueError(
                f"sweep_s = {self.sweep_s:g}: must not exceed most_s = {self.most_s:g}"
            )
        return self
