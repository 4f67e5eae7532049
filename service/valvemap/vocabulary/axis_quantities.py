"""The scalars that an axis publishes, one row a quantity.

Nodes, history, metrics and their documentation are made from these rows. A new quantity is a row
here and its value in `AxisResults.numbers` (``pipeline/axis_ports.py``).
"""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class AxisQuantity:
    """One scalar of an axis.

    Attributes
    ----------
    name
        Last segment of the NodeId ``s=<Axis>.<name>``; also its column in the history.
    sentence
        For nodes and the documentation.
    series
        Name of its series in Prometheus, labelled by axis; None: there is none.
    """

    name: str
    sentence: str
    series: str | None = None


AXIS_QUANTITIES: Final = (
    AxisQuantity(
        "BulkModulus",
        "Bulk modulus of oil and hoses, GPa.",
        "valvemap_axis_bulk_modulus_gigapascals",
    ),
    AxisQuantity("BulkModulusStd", "Standard deviation of BulkModulus, GPa."),
    AxisQuantity(
        "Leakage",
        "Leakage between the lines A and B, in (l/min)/bar; at 40 °C, if there is T.",
        "valvemap_axis_leakage_litres_per_minute_bar",
    ),
    AxisQuantity("LeakageStd", "Standard deviation of Leakage, in (l/min)/bar."),
    AxisQuantity(
        "Air",
        "Free air in the lines at atmospheric pressure, % of their volume.",
        "valvemap_axis_air_percent",
    ),
    AxisQuantity("AirStd", "Standard deviation of Air, %."),
    AxisQuantity(
        "Play", "Width of the loop of U: hysteresis of the spool, %.", "valvemap_axis_play_percent"
    ),
    AxisQuantity(
        "SpoolFrequency",
        "Natural frequency of the spool, Hz.",
        "valvemap_axis_spool_frequency_hertz",
    ),
    AxisQuantity(
        "Used",
        "Movement that the present map was learnt from, s.",
        "valvemap_axis_used_seconds",
    ),
)
