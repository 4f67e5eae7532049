"""Limits and delays of alarms."""

from typing import Self

from pydantic import Field, model_validator

from valvemap.config.sections import NotNegative, Section
from valvemap.pipeline.alarm_rules import RULES, Alarm
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.service_alarms import SERVICE_RULES
from valvemap.vocabulary.service_alarms import ServiceAlarm


class AlarmConfig(Section):
    """One alarm; omitted fields have their defaults."""

    limit: NotNegative | None = Field(
        None, description="the alarm becomes active above this value; in the alarm's unit"
    )
    hysteresis: NotNegative | None = Field(
        None, description="the alarm becomes inactive below the limit minus this"
    )
    delay_s: float | None = Field(
        None, ge=0.0, le=2_592_000.0, description="time for which the limit must be exceeded"
    )
    severity: int | None = Field(None, ge=1, le=1_000, description="severity while it is active")

    def rule(self, default: AlarmRule) -> AlarmRule:
        """Return the rule with its defaults; the hysteresis is at most the limit."""
        limit = default.limit if self.limit is None else self.limit
        hysteresis = default.hysteresis if self.hysteresis is None else self.hysteresis
        return AlarmRule(
            limit=limit,
            hysteresis=min(hysteresis, limit),
            delay_s=default.delay_s if self.delay_s is None else self.delay_s,
            severity=default.severity if self.severity is None else self.severity,
        )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.limit is not None and self.hysteresis is not None and self.hysteresis > self.limit:
            raise ValueError(f"hysteresis = {self.hysteresis:g}: at most limit = {self.limit:g}")
        return self


class AlarmsConfig(Section):
    """The alarms of one valve."""

    Changed: AlarmConfig = Field(AlarmConfig(), description="% of the flow's range; default 0.25")
    Residual: AlarmConfig = Field(AlarmConfig(), description="times the usual; default 2.5")
    Misfit: AlarmConfig = Field(AlarmConfig(), description="% of the flow's range; default 1")
    SensorLost: AlarmConfig = Field(AlarmConfig(), description="s; default 2")
    SensorFrozen: AlarmConfig = Field(AlarmConfig(), description="s; default 10")
    Unexcited: AlarmConfig = Field(AlarmConfig(), description="s; default 86,400")
    Extrapolated: AlarmConfig = Field(AlarmConfig(), description="0 or 1; default 0.5")
    SamplesLost: AlarmConfig = Field(AlarmConfig(), description="%; default 1")
    LagFound: AlarmConfig = Field(AlarmConfig(), description="s; default 0.1")
    LaneFailed: AlarmConfig = Field(
        AlarmConfig(), description="estimators that stopped; default 0.5"
    )

    def rules(self) -> dict[Alarm, AlarmRule]:
        """Return the rule of each alarm."""
        return {alarm: getattr(self, alarm.title).rule(RULES[alarm]) for alarm in Alarm}


class ServiceAlarmsConfig(Section):
    """The alarms of the service itself."""

    Checkpoint: AlarmConfig = Field(
        AlarmConfig(), description="s since states were kept; default 60, or 3 intervals"
    )
    Certificate: AlarmConfig = Field(
        AlarmConfig(), description="days that it is valid; it comes below; default 30"
    )
    Load: AlarmConfig = Field(AlarmConfig(), description="share of time at work; default 0.9")
    History: AlarmConfig = Field(
        AlarmConfig(), description="s for which rows of the history wait; default 10"
    )

    def rules(self, checkpoint_interval_s: float) -> dict[ServiceAlarm, AlarmRule]:
        """Return the rule of each alarm of the service."""
        found = {a: getattr(self, a.label).rule(rule) for a, rule in SERVICE_RULES.items()}
        checkpoint = found[ServiceAlarm.CHECKPOINT]
        if self.Checkpoint.limit is None and 3.0 * checkpoint_interval_s > checkpoint.limit:
            found[ServiceAlarm.CHECKPOINT] = AlarmRule(
                3.0 * checkpoint_interval_s, 0.0, checkpoint.delay_s, checkpoint.severity
            )
        return found
