"""Text of others: whatever it holds, a terminal shows one line and TOML loads."""

import ast
import sys
import tomllib
import unicodedata
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import valvemap.cli
from guarded_opcua.logs import escaped
from valvemap.foreign_text import MOST, printable, printable_lines, toml_string

ANY = st.text(st.characters(codec=None, categories=None), max_size=300)


@given(ANY)
@example("\x1b]8;;http://x\x07click\x1b]8;;\x07")
@example("\u202e\u2066\ufeff\u200b\x7f\x9b\x00\r\n\u2028\xa0")
@example("a" + "\u0336" * 5_000)
@example("[bold red]x[/] {0} %s :smile:")
@example("\ud800\udfff")
def test_what_is_printable_is_one_short_line_without_control(text):
    shown = printable(text)
    assert shown.isprintable()
    shown.encode("utf-8")
    assert len(shown) <= 10 * MOST
    runs = "".join("m" if unicodedata.category(c)[0] == "M" else " " for c in shown).split()
    assert max(map(len, runs), default=0) <= 3


def test_names_of_people_stay_as_they_are():
    for name in ("Ölpresse 7", "阀门开度", "клапан", "صمام", "วาล์ว", 'Ventil "A" \\ 3'):
        assert printable(name) == name


def test_a_name_of_a_million_characters_ends_in_an_ellipsis():
    assert printable("x" * 10**6) == "x" * (MOST - 1) + "…"


def test_lines_of_ours_stay_lines():
    assert printable_lines("a\nb\x1b") == "a\nb\\x1b"


@given(ANY)
@example('\x7f\x00\x1f"\\\u2028\U000e0001')
def test_a_toml_string_loads_as_the_text(text):
    if any(0xD800 <= ord(c) <= 0xDFFF for c in text):
        with pytest.raises(ValueError, match="surrogate"):
            toml_string(text)
        return
    assert tomllib.loads(f"name = {toml_string(text)} # x")["name"] == text
    assert toml_string(text).isprintable()


def test_every_character_of_unicode_leaves_printable_and_as_the_guarded_server_shows_it():
    for code in range(sys.maxunicode + 1):
        c = chr(code)
        shown = printable(c)
        assert shown.isprintable()
        assert shown == escaped(c)


def test_commands_write_to_the_terminal_by_one_module_alone():
    """What they print passes through `valvemap.cli.output`, or, as the last word, `main`."""
    folder = Path(valvemap.cli.__file__).parent
    for file in sorted(folder.glob("*.py")):
        if file.name in {"output.py", "__init__.py"}:
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                direct = {"print", "typer.echo", "typer.secho", "Console", "sys.stdout.write"}
                assert called not in direct, f"{file.name}:{node.lineno} {called}"
