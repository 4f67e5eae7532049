"""The fleet: one pipeline on many machines, by way of Kafka (extra ``fleet``)."""
