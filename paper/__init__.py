"""The source paper rebuilt: its figures and tables, and a verdict on each of its claims."""

import valvemap.report.plots  # noqa: F401 - where matplotlib is missing, it says so in one line
