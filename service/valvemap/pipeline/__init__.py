"""From data changes to results: alignment, gate, estimators. Pure."""
