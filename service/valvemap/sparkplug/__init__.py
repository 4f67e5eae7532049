"""Publish results as Sparkplug B over MQTT; the publisher is an OPC UA client of the service."""
