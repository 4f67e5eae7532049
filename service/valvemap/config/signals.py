"""Configuration of a valve's signals: their columns in recordings and their units."""

from typing import Self

from pydantic import Field, field_validator, model_validator

from valvemap.config.sections import NotNegative, Section, TwoValues, per_signal
from valvemap.pipeline.units import (
    QUANTITY_OF,
    SYMBOLS,
    Measure,
    Quantity,
    Unit,
    inside,
    unit_of,
)


class SignalConfig(Section):
    """One signal; omitted fields are as in the table of recordings: %, bar, l/min, °C."""

    column: str | None = Field(None, min_length=1, description="its column in recordings")
    unit: str | None = Field(None, description=f"one of {', '.join(SYMBOLS)}")
    raw: TwoValues | None = Field(
        None,
        description="two raw values as received, e.g. [4, 20] for mA; range gives their meaning",
    )
    range: TwoValues | None = Field(
        None, description="the two values that the raw ones mean, in unit"
    )
    accuracy: NotNegative = Field(
        0.0, description="limit ± of the sensor's own error, in unit; 0: none is stated"
    )

    @field_validator("unit")
    @classmethod
    def _is_known(cls, text: str | None) -> str | None:
        if text is not None and unit_of(text) is None:
            raise ValueError(f"allowed is one of {', '.join(SYMBOLS)}")
        return text

    @model_validator(mode="after")
    def _raw_means_something(self) -> Self:
        if (self.raw is None) != (self.range is None):
            given, missing = ("raw", "range") if self.range is None else ("range", "raw")
            raise ValueError(f"{given} is given without {missing}; raw = [4, 20], range = [0, 100]")
        unit = self.known_unit
        if unit is not None and unit.quantity is Quantity.ELECTRICAL and self.raw is None:
            raise ValueError(
                f"unit = {self.unit!r}: raw and range must say what it means, e.g. raw = [4, 20] "
                "and range = [0, 100]"
            )
        return self

    @property
    def known_unit(self) -> Unit | None:
        """The configured unit, if any."""
        return None if self.unit is None else unit_of(self.unit)

    def measure(self, signal: str) -> Measure:
        """Return the configured unit and scaling of the signal."""
        return self.measure_of(QUANTITY_OF[signal])

    def measure_of(self, quantity: Quantity) -> Measure:
        """Return the configured unit and scaling of a signal of this quantity."""
        unit = self.known_unit
        if unit is not None and unit.quantity is Quantity.ELECTRICAL:
            unit = inside(quantity)  # the configured unit is that of raw
        return Measure(self.column, unit, self.raw, self.range)

    def check_quantity(self, name: str, quantity: Quantity) -> None:
        """Refuse a unit of another quantity.

        Raises
        ------
        ValueError
            naming the signal, its unit and a unit that fits.
        """
        unit = self.measure_of(quantity).unit
        if unit is not None and unit.quantity is not quantity:
            raise ValueError(
                f"{name}.unit = {self.unit!r} is a unit of {unit.quantity.noun}; "
                f"a unit of {quantity.noun} is needed, such as {quantity.value}"
            )

    def in_words(self, quantity: Quantity) -> str:
        """Return unit and scaling of a signal of this quantity in words.

        >>> SignalConfig(unit="mA", raw=(4, 20), range=(0, 100)).in_words(Quantity.OPENING)
        '[4, 20] mA for [0, 100] %'
        """
        unit = (self.measure_of(quantity).unit or inside(quantity)).symbol
        if self.raw is None or self.range is None:
            return unit
        known = self.known_unit
        raw = known.symbol if known is not None and known.quantity is Quantity.ELECTRICAL else "raw"
        low, high = self.raw
        least, most = self.range
        return f"[{low:g}, {high:g}] {raw} for [{least:g}, {most:g}] {unit}"

    def error_limit(self, signal: str) -> float:
        """Return the limit ± of the sensor's error, in the internal unit."""
        unit = self.measure(signal).unit or inside(QUANTITY_OF[signal])
        return float(unit.factor) * self.accuracy


class SignalsConfig(per_signal("Signals", lambda _: (SignalConfig, SignalConfig()))):  # type: ignore[misc]
    """The signals of a valve, and the commands that are written."""

    dp: SignalConfig = SignalConfig()
    required_U: SignalConfig = SignalConfig()
    load: SignalConfig = SignalConfig()

    @model_validator(mode="after")
    def _quantities_fit(self) -> Self:
        for name, quantity in QUANTITY_OF.items():
            signal: SignalConfig = getattr(self, name)
            signal.check_quantity(name, quantity)
        return self
