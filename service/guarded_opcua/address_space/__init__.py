"""Nodes: creation, Read, Write, Browse; the nodes that describe the server."""
