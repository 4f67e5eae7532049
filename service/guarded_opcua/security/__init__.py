"""Certificates, users, and who may do what."""
