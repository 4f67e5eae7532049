"""The paper's Figure 1: which source data serve to identify a flow map, and how."""

from typing import Final

from paper.learning import UNSETTLED
from paper.source_types import SourceTypes
from paper.verdict import Claim, Part

_NOISE: Final = 1.0  # σ
_WHY_NOISE: Final = "an error within the meter's noise (0.4 l/min) is none that matters"
_WHY_MORE: Final = "as of the other claims: √2 times is a difference"


def claim_15(types: SourceTypes) -> Claim:
    """Quasi-static data need no inertia, dynamic ones do; structured data have gaps."""
    static, dynamic = types.static, types.dynamic
    rest, slow, quick = static["static"], static["quasi-static"], static["dynamic"]
    return Claim(
        15,
        "Quasi-static data are slow enough to neglect inertia, in dynamic data it has to be taken "
        "into account; structured data leave gaps that create deviations, scattered data cover the "
        "range, operating points a part of it (its Figure 1).",
        (
            Part(
                "error of a static map from scattered quasi-static data",
                "σ",
                "at most",
                _NOISE,
                _WHY_NOISE,
                (slow["scattered"],),
            ),
            Part(
                "the same from dynamic data, over that",
                "",
                "more than",
                UNSETTLED,
                _WHY_MORE,
                (quick["scattered"] / slow["scattered"],),
            ),
            Part(
                "error of a map that is found together with spool and meter, from dynamic data",
                "σ",
                "at most",
                _NOISE,
                _WHY_NOISE,
                (dynamic["scattered"],),
            ),
            Part(
                "error of a static map from structured data at rest, over that from scattered ones",
                "",
                "more than",
                UNSETTLED,
                _WHY_MORE,
                (rest["structured"] / rest["scattered"],),
            ),
            Part(
                "the same of operating points, over the whole range",
                "",
                "more than",
                UNSETTLED,
                _WHY_MORE,
                (rest["operating points"] / rest["scattered"],),
            ),
        ),
        "Errors over the range in σ, static map: "
        + "; ".join(
            f"{time}: " + ", ".join(f"{form} {error:.2g}" for form, error in of.items())
            for time, of in static.items()
        )
        + ". With spool and meter, dynamic data: "
        + ", ".join(f"{form} {error:.2g}" for form, error in dynamic.items())
        + ". 6,000 samples each; the spool has 8 Hz, the meter lags by 20 ms.",
        sets=1,
    )
