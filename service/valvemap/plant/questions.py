"""Questions about a valve: readings to choose from, with their consequences."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Option:
    """One reading of a question: its sentence, its consequence, and the answers that choose it.

    ``explained`` is the share of Q that the orifice law explains in it; NaN if Q does not move.
    ``against`` names what contradicts it.
    """

    text: str
    consequence: str
    answers: tuple[str, ...]
    probability: float
    explained: float = float("nan")
    against: tuple[str, ...] = ()


@dataclass(frozen=True)
class Question:
    """An open point of one valve; without options nothing can be chosen.

    ``otherwise`` are answers, to be completed, for what none of the options is.
    """

    about: str
    options: tuple[Option, ...] = ()
    otherwise: tuple[str, ...] = ()
