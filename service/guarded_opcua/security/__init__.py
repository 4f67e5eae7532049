"""Certificates, users and roles."""
