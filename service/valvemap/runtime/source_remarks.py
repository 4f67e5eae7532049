"""What a source says of the nodes of each valve, as it is published with the valve's results."""

from collections.abc import Mapping, Sequence

from valvemap.pipeline.identification import Identification
from valvemap.pipeline.source_ports import AllSources


class SourceRemarks:
    """Hands the remarks of a source to the identification.

    Parameters
    ----------
    identification
        Publishes them.
    source
        Makes them.
    """

    def __init__(self, identification: Identification, source: AllSources) -> None:
        self._identification, self._source = identification, source
        self._noted: Mapping[int, tuple[str, ...]] = {}

    def note_changes(self) -> Sequence[int]:
        """Note the remarks on each valve where they changed; return these valves."""
        remarks = self._source.remarks
        if remarks is self._noted or remarks == self._noted:
            return ()
        both = remarks.keys() | self._noted.keys()
        changed = [n for n in sorted(both) if remarks.get(n) != self._noted.get(n)]
        self._noted = remarks
        for valve in changed:
            self._identification.note_source(valve, remarks.get(valve, ()))
        return changed
