"""Bounded client sessions on OPC UA servers, and the page's view of the results."""
