"""Histories of variables and events: the historian port and HistoryRead (Part 11)."""
