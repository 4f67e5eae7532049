"""The running service: connections, sources, publishing and checkpoints, on asyncio."""
