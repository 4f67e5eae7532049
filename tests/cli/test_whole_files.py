"""Commands write the files of people aside and rename them: a kill leaves none half."""

import json
import subprocess
import sys

WATCHED = """
import json, os, sys
from pathlib import Path
folder, written = sys.argv[1], []

def hook(event, given):
    if event != "open" or not str(given[0]).startswith(folder):
        return
    path, mode, flags = given
    writes = any(c in mode for c in "wax+") if mode else flags & (os.O_WRONLY | os.O_RDWR)
    if writes:
        written.append(Path(str(path)).name)

sys.addaudithook(hook)
from valvemap.cli import run
codes = [run(["init", "--data", folder + "/data"]), run(["init", "--data", folder + "/data"])]
rejected = Path(folder, "data/pki/service/own")
codes += [run(["trust", str(next(rejected.glob("*.der"))), "--data", folder + "/data"])]
print(json.dumps([codes, written]))
"""


def test_init_and_trust_write_no_file_in_place(tmp_path):
    command = [sys.executable, "-c", WATCHED, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    codes, written = json.loads(done.stdout.splitlines()[-1])
    assert codes == [0, 0, 0]
    assert len(written) > 10
    assert [name for name in written if not name.startswith(".")] == []
    names = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(name.startswith(".") for name in names)
    assert {"service.toml", "users.json", "source-password", "dashboard-password"} <= set(names)
