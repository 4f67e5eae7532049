"""OPC UA binary (Part 6): encoding, and bounded decoding of untrusted input."""
