"""Build hook: a platform wheel that holds its kernels compiled (`make wheel`).

``VALVEMAP_KERNELS`` names a Python that has what valvemap depends on; with it, this hook compiles
all kernels for each kind of machine of ``valvemap.model.kernels.ahead``, or for those that
``VALVEMAP_KERNEL_KINDS`` names, separated by commas, and tags the wheel for that Python and
platform. Without it the wheel is pure, and the first start compiles.
"""

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "valvemap"
HOME = f"{PACKAGE}/model/kernels/compiled_ahead"
ASK = f"""
import json, sys
from {PACKAGE}.model.kernels import ahead
from {PACKAGE}.numba_version import is_tested
kinds = {{kind: ahead.place(kind) for kind in ahead.KINDS}}
tag = f"cp{{sys.version_info[0]}}{{sys.version_info[1]}}"
print(json.dumps([is_tested(), ahead.INTO, tag, kinds]))
"""
PACK = f"""
import sys
from pathlib import Path
from {PACKAGE}.model.kernels import packing, warmed_up
assert warmed_up.was_warmed_up(), "sources changed while their kernels were compiled"
assert packing.pack(Path(sys.argv[1])) > 0
"""
ISOLATING = {"PYTHONPATH", "PYTHONNOUSERSITE"}  # pip's, for the build's own Python
TAG = "manylinux_2_28_x86_64"  # as old as the wheels of numba allow


class KernelsAhead(BuildHookInterface):  # type: ignore[type-arg]
    """Adds compiled kernels to a wheel that is asked for with them."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and list the folders to be added; an editable install gets none."""
        python = os.environ.get("VALVEMAP_KERNELS")
        if not python or version == "editable":
            return
        answer = self._run([python, "-c", ASK], {})
        is_tested, into, tag, kinds = json.loads(answer)
        if not is_tested:
            raise RuntimeError("kernels are compiled ahead with a tested numba alone")
        wanted = os.environ.get("VALVEMAP_KERNEL_KINDS", ",".join(kinds)).split(",")
        if unknown := sorted(set(wanted) - kinds.keys()):
            raise RuntimeError(
                f"VALVEMAP_KERNEL_KINDS: {unknown[0]!r} is none of {', '.join(kinds)}"
            )
        self._folder = Path(tempfile.mkdtemp(prefix="valvemap-kernels-"))
        for kind in wanted:
            place = kinds[kind]
            folder = self._folder / place
            folder.mkdir(parents=True)
            environment = {
                into: str(folder),
                "NUMBA_CPU_NAME": kind,
                "NUMBA_CPU_FEATURES": "",
                "NUMBA_CACHE_DIR": str(self._folder / "unused"),
            }
            self.app.display_info(f"compiling for {kind} ...")
            self._run([python, "-m", PACKAGE, "warm-up"], environment)
            self._run([python, "-c", PACK, str(folder)], environment)
            build_data["force_include"][str(folder)] = f"{HOME}/{place}"
        build_data["pure_python"] = False
        build_data["tag"] = f"{tag}-none-{TAG}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the compiled kernels: the wheel holds them."""
        del version, build_data, artifact_path
        if hasattr(self, "_folder"):
            shutil.rmtree(self._folder)

    def _environment(self) -> dict[str, str]:
        """The process's own, less pip's isolation, with the packages of this tree in front."""
        packages = (str(Path(self.root, folder)) for folder in ("service", "virtual_rig"))
        kept = {k: v for k, v in os.environ.items() if k not in ISOLATING}
        return kept | {"PYTHONPATH": os.pathsep.join(packages)}

    def _run(self, command: list[str], environment: dict[str, str]) -> str:
        done = subprocess.run(
            command,
            cwd=self.root,
            env=self._environment() | environment,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return done.stdout
