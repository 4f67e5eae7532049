"""Subscriptions: when they publish, and what they keep for Republish."""
