"""The covariance P of maximum likelihood: forgetting, and the prior variance of the noise's d."""

from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.factors import project, rank_one, write_covariance
from valvemap.model.kernels.likelihood_memory import (
    BOUNDLESS,
    DIRECTIONAL,
    NOISE_PRIOR,
    VARIANCE,
    Memory,
    Scratch,
)
from valvemap.model.samples import Floats


@inner
def forget(
    factor: Floats, kind: int, lam: float, ramp: float, scratch: Scratch, r: float, before: float
) -> None:
    """P after the sample: (P - L·hfᵀP)/λ, or λ along hf alone (Kulhavý 1987); the ramp always."""
    f = scratch.f[: len(factor)]
    if kind == DIRECTIONAL:
        weight = 1.0
        if r > 0.0 and before > 0.0:
            weight -= (1.0 - lam) * max(0.0, ramp / r - 1.0 / before)
        rank_one(factor, f, scratch.work, ramp, weight, 1.0 / ramp)
    else:
        rank_one(factor, f, scratch.work, ramp * lam, 1.0, 1.0 / (ramp * lam))


@inner
def let_noise_in(memory: Memory, ns: int) -> None:
    """Give d its prior variance, in units of the current noise variance."""
    variance = min(NOISE_PRIOR / memory.monitor[VARIANCE], BOUNDLESS)
    for j in range(ns, len(memory.theta)):
        memory.prior[j] = 10.0 * variance  # room for forgetting
        memory.factor[j, j] = variance
        memory.spread[j, j] = variance


@inner
def draw_noise_in(memory: Memory, scratch: Scratch, ns: int, variance: float) -> None:
    """Reduce d's prior variance after the noise variance has grown."""
    information = 1.0 / variance - 10.0 / memory.prior[ns]
    for j in range(ns, len(memory.theta)):
        memory.prior[j] = 10.0 * variance
        scratch.work[:] = 0.0
        scratch.work[j] = 1.0
        project(memory.factor, scratch.work, scratch.f, scratch.Ph)
        rank_one(memory.factor, scratch.f, scratch.work, 1.0, information, 1.0)
    write_covariance(memory.factor, memory.spread)
