"""Connections: listening, channels, requests in fair turns."""
