"""Files: checkpoints and recordings."""
