"""How an estimator takes residuals that stay: as misfit of its structure, or as a plant that moves.

A residual that comes back at the same place (U, dp) is misfit; one that moves with time is drift;
before a place has been seen again nobody can tell. A residual that goes with what is new in U is
neither.
"""

from enum import IntEnum


class Adaptation(IntEnum):
    """What an estimator makes of its residuals, and what it does with its memory for that.

    Examples
    --------
    >>> Adaptation.MISFIT.sentence
    'Residuals come back at the same places: the structure does not fit; the memory is kept.'
    """

    STEADY = 0
    UNDECIDED = 1
    MISFIT = 2
    DRIFT = 3
    REACTING = 4

    @property
    def sentence(self) -> str:
        """A sentence for the operator."""
        return _SENTENCES[self]


_SENTENCES = {
    Adaptation.STEADY: "Residuals are noise; the memory is long.",
    Adaptation.UNDECIDED: "Misfit and drift cannot be told apart: too few places were seen "
    "again, or the estimator does not look; the memory is as configured.",
    Adaptation.MISFIT: "Residuals come back at the same places: the structure does not fit; "
    "the memory is kept.",
    Adaptation.DRIFT: "Places seen again show another flow than before: the valve moves, and the "
    "memory is shortened to follow it.",
    Adaptation.REACTING: "What is new in U from sample to sample goes with the residual: U reacts "
    "to the noise of the same sample, or is as noisy itself; the map is biased by that.",
}
