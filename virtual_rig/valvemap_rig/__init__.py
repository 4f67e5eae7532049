"""A simulated hydraulic test rig; its physical model is independent of the service under test."""
