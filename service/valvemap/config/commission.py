"""The section of a valve's commissioning: what `valvemap commission` may do to the plant."""

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from valvemap.config.sections import Positive, Range, Section, rising

Percent = Annotated[float, Field(ge=-100.0, le=100.0)]
Load = Annotated[float, Field(ge=0.0, le=1_000.0)]


class CommissionConfig(Section):
    """How `valvemap commission` drives the valve: U is written to ``nodes.required_U``.

    Every command is within range and slew. Beyond a limit of p1, p2 or Q, U retreats towards
    ``safe_percent``; above ``p_most_bar`` the run ends. With ``nodes.load``, the set point of p2 is
    written as well, and retreats towards ``safe_load_bar``.
    """

    range_percent: Annotated[tuple[Percent, Percent], AfterValidator(rising)] | None = Field(
        None, description="lowest and highest U that is written; none = U_range_percent"
    )
    slew_percent_per_s: float = Field(
        400.0, gt=0.0, le=10_000.0, description="fastest change of U that is written"
    )
    safe_percent: Percent | None = Field(
        None, description="U that the valve returns to; none: the permitted U nearest to 0"
    )
    load_range_bar: Annotated[tuple[Load, Load], AfterValidator(rising)] | None = Field(
        None, description="lowest and highest set point of the load, needed with nodes.load"
    )
    load_slew_bar_per_s: float = Field(
        400.0, gt=0.0, le=10_000.0, description="fastest change of the load's set point"
    )
    safe_load_bar: Load | None = Field(
        None, description="set point that the load returns to, needed with nodes.load"
    )
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
    p_most_bar: Positive | None = Field(
        None, description="pressure above which the run ends; none: any"
    )
    max_age_s: float = Field(
        0.15, ge=0.05, le=5.0, description="age of the newest sample above which the run pauses"
    )
    operator_s: float = Field(
        1.0, ge=0.1, le=60.0, description="time without the operator's terminal that ends the run"
    )
    operator_late_s: float = Field(
        0.1, ge=0.05, le=60.0, description="delay of the operator's sign that moves U to safety"
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
        if self.sweep_s > self.most_s:
            raise ValueError(
                f"sweep_s = {self.sweep_s:g}: must not exceed most_s = {self.most_s:g}"
            )
        for name, end in (("p1_range_bar", 0), ("p2_range_bar", 0), ("load_range_bar", 1)):
            given, most = getattr(self, name), self.p_most_bar
            if given is not None and most is not None and given[end] >= most:
                raise ValueError(
                    f"p_most_bar = {most:g}: must exceed {given[end]:g} of {name} = "
                    f"{list(given)}; the run ends above p_most_bar"
                )
        return self

    def check_within(self, U_range: Range, *, has_load: bool) -> None:
        """Check against the rest of the valve's configuration.

        Raises
        ------
        ValueError
            naming the field.
        """
        bounds, safe = self.range_percent or U_range, self.safe_percent
        if safe is not None and not bounds[0] <= safe <= bounds[1]:
            of = "range_percent" if self.range_percent is not None else "U_range_percent"
            raise ValueError(
                f"commission.safe_percent = {safe:g}: must be within {of} = {list(bounds)}"
            )
        given, load = self.load_range_bar, self.safe_load_bar
        if has_load and (given is None or load is None):
            missing = "load_range_bar" if given is None else "safe_load_bar"
            raise ValueError(f"commission.{missing} is needed with nodes.load")
        if not has_load and not (given is None and load is None):
            name = "safe_load_bar" if given is None else "load_range_bar"
            raise ValueError(f"commission.{name}: nodes.load is needed; no load is written without")
        if given is not None and load is not None and not given[0] <= load <= given[1]:
            raise ValueError(
                f"commission.safe_load_bar = {load:g}: must be within load_range_bar = "
                f"{list(given)}"
            )
