"""Why samples of valves are not used, in words. Pure."""

from valvemap.model.samples import Codes, Times
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.vocabulary.statuses import Quality


class WaitingReasons:
    """What the source, the alignment and the check of plausibility say of valves.

    Parameters
    ----------
    valves
        The valves.
    arrivals, intake
        Alignment and newest samples.
    """

    def __init__(self, valves: AllValves, arrivals: Arrivals, intake: SampleIntake) -> None:
        self._valves, self._arrivals, self._intake = valves, arrivals, intake
        self._of_source: dict[int, tuple[str, ...]] = {}

    def of(self, valves: Times, at_best: Codes) -> list[tuple[str, ...]]:
        """Reasons why given valves' (M,) samples are not used; else their signals at rest."""
        plans, idle = self._valves.plans, at_best == Quality.BAD
        idle |= self._intake.implausible[valves]
        return [
            self._reasons(valve)
            if is_idle
            else self._of_source.get(valve, ())
            + self._arrivals.stand_still(valve, plans[valve].nodes)
            for valve, is_idle in zip(valves.tolist(), idle.tolist(), strict=True)
        ]

    def waited_for(self, valve: int) -> tuple[str, ...]:
        """Return what the source says of a valve's nodes, else its missing signals."""
        said = self._of_source.get(valve)
        return said or self._arrivals.waited_for(valve, self._valves.plans[valve].nodes)

    def note_source(self, valve: int, words: tuple[str, ...]) -> None:
        """Note what the source says of a valve's nodes."""
        self._of_source[valve] = words

    def _reasons(self, valve: int) -> tuple[str, ...]:
        if self._intake.implausible[valve]:
            return tuple(finding.sentence for finding in self._intake.findings(valve))
        return self.waited_for(valve)
