"""The viscosity of an axis' oil by its temperature."""

import math
from typing import Final

from valvemap.model.kernels.compiled import kernel

KELVIN: Final = 273.15
WALTHER_SHIFT: Final = 0.7  # mm²/s, as of ASTM D341


@kernel
def thinness(T: float, a: float, b: float) -> float:
    """Return the viscosity at 40 °C over that at T (°C), by Walther's equation; NaN without T."""
    if not -50.0 < T < 200.0:
        return math.nan
    at_40: float = 10.0 ** (10.0 ** (a - b * math.log10(40.0 + KELVIN))) - WALTHER_SHIFT
    at_T: float = 10.0 ** (10.0 ** (a - b * math.log10(T + KELVIN))) - WALTHER_SHIFT
    return at_40 / at_T
