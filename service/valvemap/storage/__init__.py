"""Files: checkpoints, history, recordings and models."""
