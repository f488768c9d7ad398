"""The command as a process of its own: its codes, and an interrupt before it has begun."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import entry_points

from comparisons.process import run

INTERRUPTED_WHILE_LOADING = """
import sys

class Interrupt:
    def find_spec(self, name, path, target=None):
        if name == "comparisons.cli":
            raise KeyboardInterrupt

from comparisons.process import run
sys.meta_path.insert(0, Interrupt())
sys.exit(run())
"""


def process(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def test_it_is_what_the_command_runs() -> None:
    (command,) = entry_points(group="console_scripts", name="sindy-surge")
    assert command.load() is run


def test_the_codes_are_those_of_the_command_line() -> None:
    code = "import sys; from comparisons.process import run; sys.exit(run())"
    done = process(code, "--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout
    refused = process(code, "inspect", "no-such-file.csv")
    assert refused.returncode == 2
    assert refused.stderr.startswith("sindy-surge: no-such-file.csv")


def test_an_interrupt_before_it_has_begun_is_told_without_a_traceback() -> None:
    found = process(INTERRUPTED_WHILE_LOADING, "inspect", "no-such-file.csv")
    assert found.returncode == 130
    assert found.stderr == "sindy-surge: interrupted\n"
