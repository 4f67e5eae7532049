"""The last action on a valve and the last refusal, as variables of the valve."""

from asyncua import ua

from guarded_opcua import Clock, caller
from valvemap.opcua_results.information_model import BASELINE, LAST_ACTION
from valvemap.opcua_results.result_values import Shown
from valvemap.opcua_results.result_variables import ResultVariables


class ResultNotes:
    """Writes LastAction and LastRefusal; ``clock`` gives their source time."""

    def __init__(self, variables: ResultVariables, clock: Clock) -> None:
        self._variables = variables
        self._clock = clock

    def acted(self, valve: str, action: str) -> None:
        """Publish an action on a valve, with the name of the caller."""
        self._show(valve, LAST_ACTION, f"{caller()}: {action}")

    def refused(self, valve: str, why: str) -> None:
        """Publish why an action on the baseline was refused; a StatusCode carries no reason."""
        self._show(valve, f"{BASELINE}.LastRefusal", why)

    def _show(self, valve: str, name: str, words: str) -> None:
        self._variables.show(valve, Shown(name, words, ua.StatusCodes.Good, self._clock.now()))
