"""The composition root: configuration in, running services out."""
