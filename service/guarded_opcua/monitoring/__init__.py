"""Monitored items: sampling, queueing and filtering, item by item and as arrays."""
