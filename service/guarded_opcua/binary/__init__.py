"""OPC UA binary (Part 6): encoding, and decoding what cannot be believed."""
