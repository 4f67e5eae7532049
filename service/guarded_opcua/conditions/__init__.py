"""Conditions (Part 9): what stays until somebody has seen it, as events, nodes and methods."""
