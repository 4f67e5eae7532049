"""Messages about the signals that are missing for a valve's samples, with a remedy. Pure."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from valvemap.model.samples import Times
from valvemap.pipeline.alignment import AlignmentSettings
from valvemap.pipeline.kernels.waiting import NEVER
from valvemap.vocabulary.signals import REQUIRED, SENSORS

SELDOM_NS: Final = 500_000_000  # delay beyond which a signal is on-change or has stopped


def waited_for(
    newest: Times,
    settings: AlignmentSettings,
    *,
    optional: tuple[str, ...],
    nodes: Mapping[str, str] = MappingProxyType({}),
) -> tuple[str, ...]:
    """Return a sentence for each signal whose absence prevents samples.

    Parameters
    ----------
    newest : (COUNT,)
        Source time of each signal's newest value, UTC ns; ``NEVER`` before the first.
    settings
        The alignment's settings.
    optional
        Names of the valve's optional signals.
    nodes
        Names of the signals in messages: that in the configuration, then the node, if known.

    Examples
    --------
    >>> import numpy as np
    >>> newest = np.array([5_000_000, 5_000_000, 2_000_000, 5_000_000, NEVER])
    >>> waited_for(newest, AlignmentSettings(), optional=())
    ('p2 is stamped 3 ms before the others: alignment.tolerance_ms = 6',)
    """
    signals = [(s, s.label) for s in SENSORS if s.label in (*REQUIRED, *optional)]
    if all(newest[signal] == NEVER for signal, _ in signals):
        return ("no signal has sent a value: does the source publish?",)
    latest = max(int(newest[signal]) for signal, _ in signals)
    found = []
    for signal, name in signals:
        behind, said = latest - int(newest[signal]), nodes.get(name, name)
        if newest[signal] == NEVER:
            key = said.partition(" ")[0]
            found.append(f"{said} has sent no value: is nodes.{key} the right node?")
        elif behind > max(SELDOM_NS, settings.hold_ns.get(signal, 0)):
            found.append(
                f"{said} sent its last value {behind * 1e-9:.1f} s before the others: if it comes "
                f"on change, alignment.hold_s = {{ {name} = {max(10.0, behind * 5e-9):.0f} }}"
            )
        elif behind > settings.tolerance_ns and signal not in settings.hold_ns:
            found.append(
                f"{said} is stamped {behind * 1e-6:.3g} ms before the others: "
                f"alignment.tolerance_ms = {-(-2 * behind // 1_000_000)}"
            )
    return tuple(found)
