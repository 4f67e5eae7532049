"""Models as FMI 2.0 co-simulation units (.fmu): description, C source and, with a compiler, binary.

Inputs are U (%), Q_demand (l/min) and dp (bar). Outputs are the flow Q and the required U, each
with its 95 % interval and a status.
"""

import hashlib
import platform
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import StorageError
from valvemap.model.samples import Floats
from valvemap.model.valve_tables import ValveTables
from valvemap.owned_files import written_aside
from valvemap.storage.fmi_source import FMI_CALLS, FMI_TYPES
from valvemap.storage.fmi_table_source import TABLE_CALLS
from valvemap.storage.lookup_tables import as_c
from valvemap.storage.table_text import STATUSES, c_marks, c_numbers, c_rows, error_text

IDENTIFIER: Final = "valvemap_valve"
COMPILERS: Final = ("cc", "gcc", "clang")
FLAGS: Final = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off")
_DATE: Final = (1980, 1, 1, 0, 0, 0)  # of all files, so that equal models are equal units
_STATUS: Final = ", ".join(f"{code} {name}" for name, code in STATUSES.items())
_UNITS: Final = (  # name, factor to the base unit, exponents of the base unit
    ("%", "0.01", ""),
    ("bar", "100000", ' kg="1" m="-1" s="-2"'),
    ("l/min", "1.6666666666666667e-05", ' m="3" s="-1"'),
)
_VARIABLES: Final = (  # in the order of their references; name, causality, unit, sentence
    ("U", "input", "%", "control voltage"),
    ("Q_demand", "input", "l/min", "demanded flow"),
    ("dp", "input", "bar", "pressure drop p1 - p2"),
    ("Q", "output", "l/min", "flow at U and dp"),
    ("Q_lower", "output", "l/min", "95 % interval of a measured flow, lower bound"),
    ("Q_upper", "output", "l/min", "95 % interval of a measured flow, upper bound"),
    ("U_required", "output", "%", "control voltage that delivers Q_demand at dp"),
    ("U_lower", "output", "%", "95 % interval of U_required, lower bound"),
    ("U_upper", "output", "%", "95 % interval of U_required, upper bound"),
    ("Q_status", "output", None, f"status of Q: {_STATUS}"),
    ("U_status", "output", None, f"status of U_required: {_STATUS}"),
    ("error_Q", "constant", "l/min", "largest error of Q against the map"),
    ("error_U_required", "constant", "%", "largest error of U_required against the inverse"),
    ("error_Q_delivered", "constant", "l/min", "largest error of the flow that U_required gives"),
)


def write_unit(file: Path, tables: ValveTables, title: str) -> str | None:
    """Write a unit; return the platform of its binary, None if there is no compiler here.

    Raises
    ------
    StorageError
        if the file cannot be written, or the compiler fails; names it.
    """
    source = unit_source(tables, title)
    guid = hashlib.sha256(source.encode()).hexdigest()[:32]
    source = f'#define VALVEMAP_GUID "{guid}"\n' + source
    binary = _compiled(source)
    with written_aside(file) as draft, zipfile.ZipFile(draft, "w") as archive:
        parts = {
            "modelDescription.xml": description(tables, title, guid).encode(),
            f"sources/{IDENTIFIER}.c": source.encode(),
        }
        if binary is not None:
            parts[f"binaries/{binary[0]}"] = binary[1]
        for name, content in parts.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)
    return None if binary is None else binary[0].partition("/")[0]


def unit_source(tables: ValveTables, title: str) -> str:
    """Return one C99 file: tables, their functions, and the calls of FMI 2.0."""
    inverse, forward = tables.inverse, tables.forward
    return "\n".join(
        [
            as_c(inverse, title).replace(
                "int valvemap_required_U", "static int valvemap_required_U"
            ),
            "#include <math.h>",
            f"#define VALVEMAP_ERROR_FLOW {error_text(forward.error)}",
            f"#define VALVEMAP_DP_START {inverse.dp[-1]:.12g}",
            f"#define VALVEMAP_N_U {len(forward.U)}",
            f"#define VALVEMAP_N_S {len(forward.s)}",
            _table("double valvemap_lower[VALVEMAP_N_R][VALVEMAP_N_DP]", tables.lower),
            _table("double valvemap_upper[VALVEMAP_N_R][VALVEMAP_N_DP]", tables.upper),
            _axis("double valvemap_axis_U[VALVEMAP_N_U]", forward.U),
            _axis("double valvemap_axis_s[VALVEMAP_N_S]", forward.s),
            _table("double valvemap_Q[VALVEMAP_N_U][VALVEMAP_N_S]", forward.Q),
            _table("double valvemap_half[VALVEMAP_N_U][VALVEMAP_N_S]", forward.half),
            _marks(
                "unsigned char valvemap_flow_guess[VALVEMAP_N_U][VALVEMAP_N_S]", forward.guessed
            ),
            TABLE_CALLS,
            FMI_TYPES,
            FMI_CALLS,
        ]
    )


def description(tables: ValveTables, title: str, guid: str) -> str:
    """Return modelDescription.xml."""
    constants = tables.forward.error, tables.inverse.error_U, tables.inverse.error_Q
    starts = [0.0, 0.0, float(tables.inverse.dp[-1]), *[None] * 8]
    starts += [float(error_text(x)) for x in constants]
    variables, outputs = [], []
    for number, ((name, causality, unit, sentence), start) in enumerate(
        zip(_VARIABLES, starts, strict=True)
    ):
        kind = (
            f"<Integer{_start(start)}/>"
            if unit is None
            else f'<Real unit="{unit}"{_start(start)}/>'
        )
        role = 'causality="local" variability="constant" initial="exact"'
        if causality != "constant":
            discrete = ' variability="discrete"' if unit is None else ' variability="continuous"'
            role = f'causality="{causality}"{discrete}'
            role += ' initial="calculated"' if causality == "output" else ""
        variables.append(
            f'    <ScalarVariable name="{name}" valueReference="{number}" {role} '
            f"description={quoteattr(sentence)}>{kind}</ScalarVariable>"
        )
        if causality == "output":
            given = "1 3" if name.startswith("Q") else "2 3"
            kinds = "dependent dependent"
            outputs.append(
                f'      <Unknown index="{number + 1}" dependencies="{given}" '
                f'dependenciesKind="{kinds}"/>'
            )
    units = "\n".join(
        f'    <Unit name="{name}"><BaseUnit{base} factor="{factor}"/></Unit>'
        for name, factor, base in _UNITS
    )
    about = f"{title}; oil at {tables.inverse.T:g} °C"
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(title)} guid="{guid}"
  description={quoteattr(about)} generationTool="valvemap" variableNamingConvention="flat">
  <CoSimulation modelIdentifier="{IDENTIFIER}" canHandleVariableCommunicationStepSize="true"
    canGetAndSetFMUstate="true" canSerializeFMUstate="true">
    <SourceFiles><File name="{IDENTIFIER}.c"/></SourceFiles>
  </CoSimulation>
  <UnitDefinitions>
{units}
  </UnitDefinitions>
  <DefaultExperiment startTime="0.0" stopTime="1.0" stepSize="0.01"/>
  <ModelVariables>
{chr(10).join(variables)}
  </ModelVariables>
  <ModelStructure>
    <Outputs>
{chr(10).join(outputs)}
    </Outputs>
    <InitialUnknowns>
{chr(10).join(outputs)}
    </InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def _start(value: float | None) -> str:
    return "" if value is None else f' start="{value:.12g}"'


def _compiled(source: str) -> tuple[str, bytes] | None:
    """Return path in ``binaries`` and content of the library; None without a compiler."""
    target = {
        ("Linux", "x86_64"): ("linux64", ".so"),
        ("Darwin", "x86_64"): ("darwin64", ".dylib"),
        ("Windows", "AMD64"): ("win64", ".dll"),
    }.get((platform.system(), platform.machine()))
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None or target is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        code, library = Path(folder) / f"{IDENTIFIER}.c", Path(folder) / f"out{target[1]}"
        code.write_text(source, encoding="utf-8")
        done = subprocess.run(  # noqa: S603 - a compiler of this machine, our own text
            [compiler, *FLAGS, "-o", str(library), str(code), "-lm"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise StorageError(f"{compiler} failed: {(done.stderr.splitlines() or ['?'])[0]}")
        return f"{target[0]}/{IDENTIFIER}{target[1]}", library.read_bytes()


def _axis(name: str, values: Floats) -> str:
    return f"static const {name} = {{\n{c_numbers(values)}\n}};"


def _table(name: str, values: Floats) -> str:
    return f"static const {name} = {{\n{c_rows(values)}\n}};"


def _marks(name: str, marks: NDArray[np.bool_]) -> str:
    return f"static const {name} = {{\n{c_marks(marks)}\n}};"
