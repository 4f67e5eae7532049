"""Results as Sparkplug B over MQTT, for whoever collects them there; an OPC UA client like any."""
