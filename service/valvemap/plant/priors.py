"""Chances that are no one's measurement: of labels that are mistakes, and of odd habits."""

from typing import Final

MISTAKE: Final = 0.005
"""Of each kind of mistake in a valve's labels, over all its cases: signals swapped, a signal of
another valve, another unit, a command the other way round."""
ODD: Final = 0.03
"""Of a habit that labels do not show: gauges of two kinds, a factor that does not apply, a valve
that flows backwards all the time, a working sensor that shows exactly 0."""
