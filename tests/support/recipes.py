"""A copy of the source tree in which a test follows a recipe of CONTRIBUTING.md."""

import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree

ROOT = Path(__file__).parents[2]
SOURCES = ("service", "virtual_rig")


class Tree:
    """A copy of the sources, and which of its files were added or changed."""

    def __init__(self, folder):
        self.folder = folder
        self.touched = set()
        for name in SOURCES:
            copytree(ROOT / name, folder / name)  # with the compiled kernels

    def add(self, path, text):
        file = self.folder / path
        assert not file.exists(), path
        file.write_text(text)
        self.touched.add(path)

    def change(self, path, old, new):
        """Replace the only occurrence of ``old``."""
        file = self.folder / path
        text = file.read_text()
        assert text.count(old) == 1, f"{path}: {text.count(old)} times {old!r}"
        file.write_text(text.replace(old, new))
        self.touched.add(path)

    def before(self, path, line, new):
        self.change(path, line, new + line)

    def after(self, path, line, new):
        self.change(path, line, line + new)

    def run(self, *arguments, code=0, **environment):
        """Run Python on the copy; return its output."""
        paths = os.pathsep.join(str(self.folder / name) for name in SOURCES)
        done = subprocess.run(
            [sys.executable, *map(str, arguments)],
            env=os.environ | {"PYTHONPATH": paths} | environment,
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert done.returncode == code, done.stdout + done.stderr
        return done.stderr + done.stdout
