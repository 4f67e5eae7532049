"""The nodes: made, read, written, browsed; the server described by its own nodes."""
