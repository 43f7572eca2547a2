"""What `monitor` finds is told whatever becomes of its page, and its exit code is of nothing else."""

import subprocess
import sys

import pytest

from deadreckon.cli.main import main
from deadreckon.errors import DivergedError, UserError
from deadreckon.report import monitored
from deadreckon.runs import monitor


class Found:
    """Stands for what the comparison gives."""

    def __init__(self, alarm: bool):
        self.alarm = alarm

    def __str__(self) -> str:
        return "! drift of age"


@pytest.mark.parametrize(
    ("error", "line", "plain"),
    [(UserError("cannot write page.html: No space left on device"), "deadreckon: cannot write page.html: No space", 2),
     (MemoryError(), "deadreckon: ", 70)],
)  # fmt: skip
def test_an_alarm_is_told_where_the_page_cannot_be_written(monkeypatch, tmp_path, capsys, error, line, plain):
    def full(found, out):
        raise error

    monkeypatch.setattr(monitored, "write_monitored", full)
    for alarm, code in ((True, 1), (False, plain)):
        monkeypatch.setattr(monitor, "monitor", lambda *given, alarm=alarm, **options: Found(alarm))
        assert main(["monitor", "run", "log.csv", "--html", str(tmp_path / "page.html")]) == code
        out, err = capsys.readouterr()
        assert out == "! drift of age\n"
        assert err.startswith(line)
        assert err.count("\n") == 1


def test_a_reader_that_has_gone_does_not_change_the_exit_code():
    code = """
import sys
from deadreckon.cli.main import main
from deadreckon.runs import monitor

class Found:
    alarm = True
    def __str__(self):
        return "! drift of age" * 10_000

monitor.monitor = lambda *given, **options: Found()
sys.exit(main(["monitor", "run", "log.csv"]))
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    error = process.stderr.read()
    assert (process.wait(), error) == (1, b"")


def test_a_failed_run_is_told_from_bad_input(monkeypatch, capsys):
    for error, code in ((DivergedError("fold0 failed: loss was not finite"), 1), (UserError("no such log"), 2)):
        def fails(*given, error=error, **options):
            raise error

        monkeypatch.setattr(monitor, "monitor", fails)
        assert main(["monitor", "run", "log.csv"]) == code
        assert capsys.readouterr().err == f"deadreckon: {error}\n"


def test_a_command_that_fails_is_no_alarm(monkeypatch, capsys):
    def fails(*given, **options):
        raise ZeroDivisionError("of ours")

    monkeypatch.setattr(monitor, "monitor", fails)
    assert main(["monitor", "run", "log.csv"]) == 70
    assert "internal error, ZeroDivisionError: of ours" in capsys.readouterr().err
