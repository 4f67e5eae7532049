"""Recognition of a plant's signals by names, units, ranges and physics; servers and recordings."""
