"""Noise of the meter: a white part and a slow one, which is a first-order process.

    e_i = v_i + m_i,    m_i = φ·m_(i-1) + …,    E e_i·e_(i-k) = σ²·slow·φᵏ,  k ≥ 1

``slow`` is the slow part's share of the variance σ². With r₁ and r₂ the correlations of errors one
and two samples apart,

    φ = r₂ / r₁,    slow = r₁ / φ

White noise has slow = 0, an AR(1) process slow = 1.
"""

from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_reading as readings
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner
from valvemap.model.samples import Floats


@inner
def of_sample(flow: float, scalars: Floats) -> float:
    """Variance of the noise of a sample of this flow."""
    return float(scalars[fits.VARIANCE] * readings.ratio(scalars[fits.READING :], flow))


@inner
def of_timing(rate: float, scalars: Floats) -> float:
    """Variance of a sample by the doubt about its time, where the flow changes so fast."""
    return float(scalars[fits.VARIANCE] * (readings.ratio(scalars[fits.TIMING :], rate) - 1.0))


@inner
def note(
    error: float, weight: float, count: float, age: int, flow: float, rate: float, scalars: Floats
) -> None:  # fmt: skip
    """Add an error against the sample's own cell, of ``count`` samples, to variance and colour."""
    rest = 1.0 - 1.0 / min(max(0.5 * age, 50.0), rules.NOISE_MEMORY)  # early maps were worse
    part = count / (count + 1.0)
    square = part * error * error
    readings.note(scalars[fits.READING :], rest, weight, square, flow)
    by_flow = readings.ratio(scalars[fits.READING :], flow)
    readings.note(scalars[fits.TIMING :], rest, weight, square / by_flow, rate)
    square /= readings.ratio(scalars[fits.TIMING :], rate)
    scalars[fits.WITHIN] = rest * scalars[fits.WITHIN] + weight * square
    scalars[fits.WITHIN_WEIGHT] = rest * scalars[fits.WITHIN_WEIGHT] + weight
    last, before = scalars[fits.LAST_ERROR], scalars[fits.ERROR_BEFORE]
    skip(scalars)
    if count < rules.COLOUR_FROM:
        return
    scalars[fits.LAST_ERROR] = weight * error
    if last != 0.0:
        scalars[fits.NEXT] = rest * scalars[fits.NEXT] + weight * error * last
        scalars[fits.NEXT_WEIGHT] = rest * scalars[fits.NEXT_WEIGHT] + weight
    if before != 0.0:
        scalars[fits.AFTER] = rest * scalars[fits.AFTER] + weight * error * before
        scalars[fits.AFTER_WEIGHT] = rest * scalars[fits.AFTER_WEIGHT] + weight
    variance = max(scalars[fits.WITHIN], 1e-300) / scalars[fits.WITHIN_WEIGHT]
    many = max(scalars[fits.NEXT_WEIGHT], 1.0)
    one = scalars[fits.NEXT] / many / variance
    two = scalars[fits.AFTER] / max(scalars[fits.AFTER_WEIGHT], 1.0) / variance
    scalars[fits.COLOUR] = scalars[fits.SLOW] = 0.0
    if one > 0.0 and one * one * many > rules.SURE**2:
        scalars[fits.COLOUR] = min(max(two / one, one), rules.MOST_COLOUR)
        scalars[fits.SLOW] = min(one / scalars[fits.COLOUR], 1.0)


@inner
def skip(scalars: Floats) -> None:
    """The next error has none before it, the one after it has ``LAST_ERROR`` two before."""
    scalars[fits.ERROR_BEFORE], scalars[fits.LAST_ERROR] = scalars[fits.LAST_ERROR], 0.0


@inner
def spreads(scalars: Floats, kept: float) -> float:
    """White samples of the same weight are worth one; ``kept`` of the slow part's correlation."""
    alike = kept * scalars[fits.COLOUR]
    return float(1.0 + scalars[fits.SLOW] * ((1.0 + alike) / (1.0 - alike) - 1.0))


@inner
def of_stay(many: float, variance: float, scalars: Floats) -> float:
    """Variance of the mean of successive samples of some variance.

    The stay before has noise in common with it.
    Until its colour is known, the noise is as slow as any: what then is a change is certain.
    """
    phi, slow = scalars[fits.COLOUR], scalars[fits.SLOW]
    if scalars[fits.NEXT_WEIGHT] < rules.COLOUR_KNOWN:
        phi, slow = rules.MOST_COLOUR, 1.0
    alike = phi**many
    own = min((1.0 + phi) / (1.0 - phi) / max(many, 1.0), 1.0) * (1.0 + alike) / (1.0 - alike)
    return float(variance * ((1.0 - slow) / max(many, 1.0) + slow * own))
