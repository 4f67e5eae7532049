"""The identification service: OPC UA in, flow maps out."""
