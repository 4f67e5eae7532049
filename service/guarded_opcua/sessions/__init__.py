"""Sessions of peers, and the services that answer their requests."""
