"""The fleet: the pipeline distributed over machines with Kafka (extra ``fleet``)."""
