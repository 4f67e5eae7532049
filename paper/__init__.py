"""Reproduction of the source paper: its figures and tables, and a verdict on each claim."""

import valvemap.report.plots  # noqa: F401 - where matplotlib is missing, it says so in one line
