"""Monitored items: what they sample, queue and filter, one by one and as arrays."""
