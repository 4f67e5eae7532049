"""Logs each valve once when its estimation stops or resumes, and when its timing is found."""

import numpy as np
import structlog

from valvemap.pipeline.identification import Identification

log = structlog.get_logger(__name__)


class ValveLog:
    """Compares the valves with their last log lines."""

    def __init__(self, identification: Identification) -> None:
        self._identification = identification
        self._implausible = np.zeros(len(identification.plans), np.bool_)  # as logged

    def note_changes(self) -> None:
        """Log what has changed since the last call."""
        self._note_plausibility()
        for valve in self._identification.stamping.newly_found():
            how = "; ".join(self._identification.timing(valve))
            log.info("signals", valve=self._identification.plans[valve].name, how=how)

    def _note_plausibility(self) -> None:
        implausible = self._identification.plausibility.implausible
        for valve in (self._implausible & ~implausible).nonzero()[0].tolist():
            name = self._identification.plans[valve].name
            log.info(
                "samples accepted again", valve=name, why="its pressures have been right for long"
            )
        for valve in (implausible & ~self._implausible).nonzero()[0].tolist():
            name = self._identification.plans[valve].name
            findings = self._identification.plausibility.findings(valve)
            why = "; ".join(finding.sentence for finding in findings)
            remedy = "mend the configuration, or insist = true for this valve"
            log.warning("implausible samples rejected", valve=name, why=why, remedy=remedy)
        self._implausible[:] = implausible
