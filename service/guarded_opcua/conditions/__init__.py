"""Conditions and alarms (Part 9): their events, nodes and methods."""
