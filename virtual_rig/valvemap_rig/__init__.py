"""A hydraulic test rig in software: the physics are an independent truth for the service."""
