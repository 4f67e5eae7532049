"""The only package that imports asyncua."""
