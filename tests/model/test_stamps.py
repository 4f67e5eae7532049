"""A stamp covers the code of a module and of all that it imports, and nothing else."""

import sys
from pathlib import Path

import pytest
from hypothesis import given, seed
from hypothesis import strategies as st

from valvemap.model.kernels import stamps
from valvemap.model.kernels.stamps import Trees, parse, stamp_of

ROOT = Path(__file__).parents[2]

MINI = {
    "mini/__init__.py": "",
    "mini/kernels.py": "from mini.middle import middle\nfrom mini import far\n",
    "mini/middle.py": "import mini.rules as rules\ndef middle(x): return rules.LIMIT * x\n",
    "mini/rules.py": '"""Rules."""\nLIMIT = 3.0\n"""l/min"""\n',
    "mini/far/__init__.py": "from . import near\n",
    "mini/far/near.py": "from ..deep import *\n",
    "mini/deep.py": "A = 1\n",
    "mini/apart.py": "from mini import kernels\nB = 1\n",
    "other/__init__.py": "C = 1\n",
}


@pytest.fixture
def stamp(tmp_path):
    for name, text in MINI.items():
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True, parents=True)
        file.write_text(text)
    packages = {"mini": tmp_path / "mini"}
    return lambda: stamp_of(tmp_path / "mini/kernels.py", "mini.kernels", packages, Trees())


def change(tmp_path, name, old, new):
    file = tmp_path / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("mini/kernels.py", "far\n", "far\nX = 1\n"),
        ("mini/middle.py", "* x", "/ x"),
        ("mini/rules.py", "3.0", "4.0"),
        ("mini/rules.py", "3.0", "3"),  # another type
        ("mini/far/__init__.py", "near\n", "near\nX = 1\n"),
        ("mini/deep.py", "A = 1", "A = -1"),
    ],
)
def test_code_changed_in_any_module_behind_it_changes_the_stamp(tmp_path, stamp, file, old, new):
    before = stamp()
    change(tmp_path, file, old, new)
    assert stamp() != before


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("mini/middle.py", "import mini", "# The rules.\n\n\nimport mini"),
        (
            "mini/middle.py",
            "return rules.LIMIT * x",
            '\n    "3 x"\n    return rules.LIMIT*x',
        ),
        ("mini/rules.py", "Rules.", "What holds."),
        ("mini/rules.py", "l/min", "litres a minute"),
        ("mini/apart.py", "B = 1", "B = 2"),  # imports the kernel, which does not import it
        ("other/__init__.py", "C = 1", "C = 2"),
    ],
)
def test_comments_texts_and_what_is_not_imported_leave_it(tmp_path, stamp, file, old, new):
    before = stamp()
    change(tmp_path, file, old, new)
    assert stamp() == before


def test_modules_that_import_each_other_have_stamps(tmp_path, stamp):
    before = stamp()
    change(tmp_path, "mini/deep.py", "A = 1", "A = 1\nimport mini.kernels")
    assert stamp() not in {before, ""}
    change(tmp_path, "mini/rules.py", "3.0", "4.0")
    assert stamp() != before


def test_a_module_that_takes_the_place_of_a_name_is_noticed(tmp_path, stamp):
    before = stamp()
    (tmp_path / "mini/middle").mkdir()
    (tmp_path / "mini/middle/middle.py").write_text("X = 1\n")
    assert stamp() != before


def test_a_stamp_does_not_depend_on_the_folder(tmp_path):
    for folder in ("a", "b/c"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "m.py").write_text("import m\nX = 1\n")
    one, other = (
        stamp_of(tmp_path / folder / "m.py", "m", {"m": tmp_path / folder / "m.py"}, Trees())
        for folder in ("a", "b/c")
    )
    assert one == other


def test_what_was_parsed_is_kept_and_a_damaged_file_is_parsed_once_more(tmp_path, monkeypatch):
    source, kept = tmp_path / "m.py", tmp_path / "trees"
    source.write_text("import a\nX = 1\n")
    parsed = []
    monkeypatch.setattr(stamps, "parse", lambda *a, **k: parsed.append(a) or parse(*a, **k))
    for damage in (None, None, "", "[1]", '{"m": 1}', '{"m": []}', '{"m": ["1"]}', "null"):
        if damage is not None:
            kept.write_text(damage)
        trees = Trees(kept)
        assert trees.of(source, "m") == parse(source.read_bytes(), "m")
        trees.keep()
    assert len(parsed) == 1 + 6
    assert sorted(tmp_path.iterdir()) == [source, kept]
    source.write_text("import a\nX = 2\n")
    trees = Trees(kept)
    trees.of(source, "m")
    trees.keep()
    assert kept.read_text().count("[") == 1, "of each module the newest alone"


def test_two_programs_that_use_other_modules_do_not_forget_each_others(tmp_path, monkeypatch):
    for name in ("a", "b"):
        (tmp_path / f"{name}.py").write_text(f"X = '{name}'\n")
    parsed = []
    monkeypatch.setattr(stamps, "parse", lambda *a, **k: parsed.append(a[1]) or parse(*a, **k))
    for name in ("a", "b", "a", "b"):
        trees = Trees(tmp_path / "trees")
        trees.of(tmp_path / f"{name}.py", name)
        trees.keep()
    assert parsed == ["a", "b"]


def test_a_folder_that_cannot_be_written_costs_time_alone(tmp_path):
    source = tmp_path / "m.py"
    source.write_text("X = 1\n")
    trees = Trees(tmp_path / "nowhere" / "trees")
    trees.of(source, "m")
    trees.keep()
    assert sorted(tmp_path.iterdir()) == [source]


@seed(20)
@given(st.lists(st.sampled_from(["X = 1", "def f(x):\n  return x", "class A: b = 2"]), max_size=4))
def test_a_comment_between_any_statements_is_no_change(statements):
    bare = "\n".join(statements)
    noted = "\n# A note.\n\n".join(["", *statements, ""])
    assert parse(bare.encode(), "m") == parse(noted.encode(), "m")


def test_no_kernel_takes_code_from_outside_its_package_but_from_libraries():
    """Stamps follow a package's own imports: what kernels take elsewhere must be versioned."""
    seen, ahead = set(), [*(ROOT / "service" / "valvemap").glob("*/kernels/*.py")]
    packages = {"valvemap": ROOT / "service" / "valvemap"}
    foreign = set()
    while ahead:
        file = ahead.pop()
        if file in seen:
            continue
        seen.add(file)
        for name in parse(file.read_bytes(), "").imports:
            found = stamps._find(name, packages)
            if found is not None:
                ahead.append(found[1])
            else:
                foreign.add(name.partition(":")[0].partition(".")[0])
    assert foreign - sys.stdlib_module_names == {"numba", "numpy", "llvmlite"}
