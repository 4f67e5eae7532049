"""A proxy for the current operator, which a reload replaces."""

from typing import Any, cast

from valvemap.errors import CommandRejected
from valvemap.pipeline.operator_ports import Operator

_QUESTIONS = {
    *("alarms", "alarmed", "baseline", "compare"),
    *("predict", "predict_measurement", "predict_approved", "invert"),
}


class SuccessiveOperator:
    """Forwards each call to the current operator, including methods bound before a hand-over.

    >>> class Answers:
    ...     def __init__(self, names): self.names = names
    ...     def alarms(self, valve): return self.names
    >>> operator = SuccessiveOperator(Answers(["old"]))
    >>> bound = operator.as_operator().alarms
    >>> operator.hand_over(Answers(["new"]))
    >>> bound(None)
    ['new']
    """

    def __init__(self, in_charge: Operator) -> None:
        self._in_charge = in_charge
        self.refuses = False  # rejects commands: their effects would be lost

    def hand_over(self, to: Operator) -> None:
        """Make ``to`` the current operator."""
        self._in_charge, self.refuses = to, False

    def as_operator(self) -> Operator:
        """Return this object, typed as an Operator."""
        return cast("Operator", self)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - a method of the operator's
        def call(*arguments: Any, **named: Any) -> Any:  # noqa: ANN401 - the method's own
            if self.refuses and name not in _QUESTIONS:
                raise CommandRejected("another configuration is being put in force: try again")
            return getattr(self._in_charge, name)(*arguments, **named)

        return call
