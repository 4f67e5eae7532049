"""The section of a valve's commissioning: what `valvemap commission` may do to the plant."""

import math
from dataclasses import replace
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from valvemap.config.sections import Positive, Range, Section, rising
from valvemap.pipeline.commission_limits import Limits
from valvemap.pipeline.commission_plan import GOLDEN, Plan

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
    last_period_s: float = Field(
        0.0, ge=0.0, le=600.0, description="time of the sweep's last triangle; 0: as the others"
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
        if self.last_period_s and not (
            self.period_s <= self.last_period_s <= self.sweep_s - self.period_s
        ):
            raise ValueError(
                f"last_period_s = {self.last_period_s:g}: must be 0, or between period_s = "
                f"{self.period_s:g} and sweep_s - period_s = {self.sweep_s - self.period_s:g}"
            )
        for name, end in (("p1_range_bar", 0), ("p2_range_bar", 0), ("load_range_bar", 1)):
            given, most = getattr(self, name), self.p_most_bar
            if given is not None and most is not None and given[end] >= most:
                raise ValueError(
                    f"p_most_bar = {most:g}: must exceed {given[end]:g} of {name} = "
                    f"{list(given)}; the run ends above p_most_bar"
                )
        return self

    def limits(self, U_range: Range) -> Limits:
        """Return the limits of a run on a valve whose map covers ``U_range``."""
        low, high = self.range_percent or U_range
        anything = -math.inf, math.inf
        return Limits(
            U_range=(low, high),
            slew_percent_per_s=self.slew_percent_per_s,
            safe_U=min(max(0.0, low), high) if self.safe_percent is None else self.safe_percent,
            load_range=self.load_range_bar,
            load_slew_bar_per_s=self.load_slew_bar_per_s,
            safe_load=self.safe_load_bar or 0.0,
            p1_range=self.p1_range_bar or anything,
            p2_range=self.p2_range_bar or anything,
            Q_range=self.Q_range_l_min or anything,
            p_most=self.p_most_bar or math.inf,
        )

    def plan(self) -> Plan:
        """Return the plan of a run."""
        return Plan(self.period_s, self.sweep_s, self.most_s, self.last_period_s)

    def check_within(
        self, U_range: Range, *, is_driven: bool, has_load: bool, has_p2: bool
    ) -> None:
        """Check against the rest of the valve's configuration.

        Raises
        ------
        ValueError
            naming the field.
        """
        self._check_range(U_range)
        self._check_load(has_load=has_load)
        if not has_p2:
            self._check_without_pressures(has_load=has_load)
        if is_driven:
            self._check_slew(U_range)

    def _check_range(self, U_range: Range) -> None:
        own, safe = self.range_percent, self.safe_percent
        if own is not None and not U_range[0] <= own[0] < own[1] <= U_range[1]:
            raise ValueError(
                f"commission.range_percent = {list(own)}: must be within U_range_percent = "
                f"{list(U_range)}, which the map covers"
            )
        if own is not None and own[1] - own[0] <= self.follow_percent:
            raise ValueError(
                f"commission.range_percent = {list(own)}: must be wider than follow_percent = "
                f"{self.follow_percent:g}; a U that stands would be taken as following"
            )
        bounds = own or U_range
        if safe is not None and not bounds[0] <= safe <= bounds[1]:
            of = "range_percent" if own is not None else "U_range_percent"
            raise ValueError(
                f"commission.safe_percent = {safe:g}: must be within {of} = {list(bounds)}"
            )

    def _check_load(self, *, has_load: bool) -> None:
        given, load = self.load_range_bar, self.safe_load_bar
        if has_load and (given is None or load is None):
            missing = "load_range_bar" if given is None else "safe_load_bar"
            raise ValueError(f"commission.{missing} is needed with nodes.load")
        if not has_load and not (given is None and load is None):
            name = "safe_load_bar" if given is None else "load_range_bar"
            raise ValueError(f"commission.{name}: nodes.load is needed; no load is written without")
        for name in ("load_range_bar", "p2_range_bar"):  # a safe load must end a retreat
            bounds = getattr(self, name)
            if load is not None and bounds is not None and not bounds[0] <= load <= bounds[1]:
                raise ValueError(
                    f"commission.safe_load_bar = {load:g}: must be within {name} = {list(bounds)}"
                )

    def _check_without_pressures(self, *, has_load: bool) -> None:
        if has_load:  # the first load that is written is the measured one
            raise ValueError(
                "nodes.load: nodes.p1 and nodes.p2 are needed; dp alone does not tell the load"
            )
        for name in ("p1_range_bar", "p2_range_bar", "p_most_bar"):
            if getattr(self, name) is not None:
                raise ValueError(
                    f"commission.{name}: nodes.p1 and nodes.p2 are needed; dp alone tells no "
                    "pressure"
                )

    def _check_slew(self, U_range: Range) -> None:
        """Check that a slew that slows triangles leaves one in the sweep; with a last one, all."""
        limits, plan = self.limits(U_range), self.plan()
        needed, name = plan.paced_period(limits), "period_s" if self.last_period_s else "sweep_s"
        if needed <= max(self.period_s, getattr(self, name)):
            return
        of_load = plan.paced_period(replace(limits, load_range=None)) < needed
        slew = "load_slew_bar_per_s" if of_load else "slew_percent_per_s"
        what = "the load" if of_load else "U"
        seconds = needed / GOLDEN if of_load else needed
        raise ValueError(
            f"commission.{slew} = {getattr(self, slew):g}: {what} needs {seconds:.3g} s from end "
            f"to end and back, and {name} = {getattr(self, name):g}; raise one of them"
        )
