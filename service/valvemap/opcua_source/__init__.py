"""The source: subscribe to a plant's OPC UA server and decode its samples as arrays."""
