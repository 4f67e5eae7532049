"""The namespace URIs of service and rig, also used as their application URIs."""

SERVICE_NAMESPACE = "urn:valvemap:service"
RIG_NAMESPACE = "urn:valvemap:rig"
