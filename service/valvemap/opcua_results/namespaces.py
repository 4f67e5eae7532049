"""The namespaces of service and rig, which are their application URIs, too."""

SERVICE_NAMESPACE = "urn:valvemap:service"
RIG_NAMESPACE = "urn:valvemap:rig"
