"""From data changes to results: alignment, gate, pipeline; only the supervisor waits."""
