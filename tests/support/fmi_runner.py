"""Runs an FMI 2.0 unit by FMPy, and by its own functions at many points."""

import ctypes
import shutil

import numpy as np

INPUTS = ("U", "Q_demand", "dp")
NAMES = ("Q", "Q_lower", "Q_upper", "U_required", "U_lower", "U_upper", "error_Q")


class Running:
    """An instance of the unit; ``at`` evaluates it at many points."""

    def __init__(self, file):
        from fmpy import extract, read_model_description
        from fmpy.fmi2 import FMU2Slave

        self.described = read_model_description(str(file))
        self.folder = extract(str(file))
        self.references = {v.name: v.valueReference for v in self.described.modelVariables}
        self.slave = FMU2Slave(
            guid=self.described.guid,
            unzipDirectory=self.folder,
            modelIdentifier=self.described.coSimulation.modelIdentifier,
            instanceName="valve",
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def at(self, **inputs):
        """Outputs as arrays, by the unit's own functions without FMPy's cost of a call."""
        given = np.broadcast_arrays(*(np.atleast_1d(inputs.get(k, 1.0)) for k in INPUTS))
        rows = np.ascontiguousarray(np.column_stack(given).astype(np.float64))
        library, component = self.slave.dll, self.slave.component
        names = [name for name in NAMES if name != "error_Q"]
        out, status = np.empty((len(rows), len(names))), np.empty((len(rows), 2), np.int32)
        set_real, get_real, get_integer = (
            getattr(library, f"fmi2{name}") for name in ("SetReal", "GetReal", "GetInteger")
        )
        into, real, integer = (
            (ctypes.c_uint * len(names))(*(self.references[name] for name in names))
            for names in (INPUTS, names, ("Q_status", "U_status"))
        )
        inputs_at, outputs_at, statuses_at = (
            (kind * n).from_address
            for kind, n in ((ctypes.c_double, 3), (ctypes.c_double, len(names)), (ctypes.c_int, 2))
        )
        strides = [x.strides[0] for x in (rows, out, status)]
        at, to, said = (x.ctypes.data for x in (rows, out, status))
        for _ in range(len(rows)):
            assert set_real(component, into, 3, inputs_at(at)) == 0
            assert get_real(component, real, len(names), outputs_at(to)) == 0
            assert get_integer(component, integer, 2, statuses_at(said)) == 0
            at, to, said = (x + n for x, n in zip((at, to, said), strides, strict=True))
        return dict(zip(names, out.T, strict=True)) | {
            "Q_status": status[:, 0],
            "U_status": status[:, 1],
        }

    def close(self):
        self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self.folder)
