"""Subscriptions: publishing, retransmission and their limits."""
