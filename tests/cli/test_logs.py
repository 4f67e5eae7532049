"""What is said by others forges no line of the console."""

import codecs
import logging

import pytest
import structlog

from guarded_opcua.logs import audit_logger, bounded_logger
from valvemap.cli.logs import set_up_logs
from valvemap.config.logs import LogConfig

FORGED = "2026-11-22T00:00:00Z [info     ] session activated by anna"


@pytest.fixture(params=["console", "json"])
def console(request, capfd):
    """Do something with the logs as a command sets them up; returns the lines that came out."""
    root = logging.getLogger()
    handlers, level = root.handlers, root.level

    def lines_of(action):
        set_up_logs(LogConfig(format=request.param))
        action()
        return capfd.readouterr().err.splitlines()

    yield lines_of
    root.handlers, root.level = handlers, level
    structlog.reset_defaults()


def guarded(text):
    bounded_logger("guarded_opcua.test").warning("refused %s", text)


def audit(text):
    audit_logger().warning("%s", text)


def own(text):
    structlog.get_logger("test").warning("refused", reason=text, error=text)


def library(text):
    logging.getLogger("library").warning("refused %s", text)


@pytest.mark.parametrize("say", [guarded, audit, own, library], ids=lambda say: say.__name__)
def test_a_line_break_makes_no_further_line(console, say):
    (line,) = console(lambda: say(f"peer\n{FORGED}\r\x1b[2K\u2028"))
    assert line.isprintable()
    assert FORGED in line
    assert not line.startswith(FORGED)


def test_a_traceback_keeps_its_lines_but_none_looks_like_the_logs(console):
    def fail():
        try:
            codecs.lookup_error(f"\n{FORGED}")
        except LookupError:
            bounded_logger("guarded_opcua.test").exception("failed")

    lines = console(fail)
    assert not [line for line in lines if line.startswith(FORGED)]
    assert "Traceback" in "".join(lines)
