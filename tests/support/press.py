"""The scenario of a rig with one cylinder that an outside program leads, for tests of an axis."""

SCENARIO = """
name = "press"
valves = []
[[machines]]
name = "Axis"
measures = "position"
[machines.valve]
leakage_l_min_bar = 0.0
play_percent = 2.0
[machines.controller]
lead = "external"
"""
