"""The lines and axes of a `ShownService`: their variables, values and descriptions."""

from dataclasses import dataclass

AXIS = {
    "DeviceHealth": 0,
    "Status": 0,
    "Reason": "The edges, the bulk modulus and the leakage are identified.",
    "BulkModulus": 0.9,
    "BulkModulusStd": 0.01,
    "Leakage": 0.006,
    "LeakageStd": 0.0001,
    "Air": 0.05,
    "Play": 2.0,
    "SpoolFrequency": 40.0,
    "Used": 240.0,
    "LeftOut": ["end stop: 12"],
    "U": [0.0, 50.0, 100.0],
    **{f"{edge}.Flow": [0.0, 40.0, 90.0] for edge in ("PA", "AT", "PB", "BT")},
    **{f"{edge}.FlowStd": [0.1, 0.2, 0.9] for edge in ("PA", "AT", "PB", "BT")},
    **{f"{edge}.KnownTo": 80.0 for edge in ("PA", "AT", "PB", "BT")},
    "Inverse.SpeedDemand": float("nan"),
    "Inverse.RequiredU": float("nan"),
    "Inverse.RequiredULower": float("nan"),
    "Inverse.RequiredUUpper": float("nan"),
    "Inverse.RequiredUStatus": 4,
}
LINE = {
    "DeviceHealth": 0,
    "Frame": [1.0, 0.1, 0.0, 0.2, 0.3, 100.0, 0.0],
    "FrameNames": [
        *("Sequence", "Leak.PredictedFlow", "Leak.Residual", "Leak.ResidualRmse"),
        *("Leak.NoiseStd", "Leak.SampleCount", "Leak.Status"),
    ],
    "Leak.PredictedFlow": 0.1,
    "Leakage": 0.02,
    "LeakageStd": 0.001,
    "Signals.U": 40.0,
    "Signals.Q": 21.0,
    "Inverse.FlowDemand": 20.0,
    "Inverse.PressureDrop": 100.0,
    "Inverse.Edge": 1,
    "Inverse.RequiredU": 33.0,
    "Inverse.RequiredULower": 32.0,
    "Inverse.RequiredUUpper": 34.0,
    "Inverse.RequiredUStatus": 0,
}
_SENTENCES = {
    "BulkModulus": "Bulk modulus of oil and hoses, GPa.",
    "Leakage": "Leakage between the lines A and B, in (l/min)/bar.",
    "Inverse.SpeedDemand": "Speed of the piston that is demanded.",
}
_UNITS = {
    "Inverse.SpeedDemand": "mm/s",
    "Inverse.RequiredU": "%",
    "Inverse.FlowDemand": "l/min",
    "Inverse.PressureDrop": "bar",
    "Signals.Q": "l/min",
}


@dataclass(frozen=True)
class Engineering:
    """Fulfils `valvemap.readings.Engineering`."""

    unit: str
    description: str
    range: tuple[float, float] | None = None


def engineering(id_: str) -> Engineering:
    """Unit and description of a variable, by the name within its part."""
    segments = id_.split(".")
    for first in range(len(segments)):
        name = ".".join(segments[first:])
        if name in _SENTENCES or name in _UNITS:
            return Engineering(_UNITS.get(name, ""), _SENTENCES.get(name, f"{name}."))
    return Engineering("", f"{segments[-1]}.")


def below(names: dict, prefix: str) -> tuple[list[str], list[str]]:
    """The variables and the objects right below a node, by the names of a part's variables."""
    own = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
    variables = [name for name in own if "." not in name]
    objects = list(dict.fromkeys(name.partition(".")[0] for name in own if "." in name))
    return variables, objects
