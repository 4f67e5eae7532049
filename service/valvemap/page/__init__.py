"""The live page: an OPC UA client of the service that draws what any client can get."""
