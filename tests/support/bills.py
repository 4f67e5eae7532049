"""Validation of bills of materials."""


def complaint_of(bill):
    """What is wrong with a CycloneDX bill; None: it is valid."""
    from cyclonedx.schema import SchemaVersion  # builds parsers: four seconds of each collection
    from cyclonedx.validation.json import JsonStrictValidator

    return JsonStrictValidator(SchemaVersion.V1_6).validate_str(bill)
