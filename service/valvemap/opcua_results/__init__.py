"""The results: an OPC UA server that publishes them and accepts commands."""
