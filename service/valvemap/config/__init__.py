"""Configuration: pydantic models and their loading."""
