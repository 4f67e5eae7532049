"""Connections: listening, secure channels, fair scheduling of requests."""
