"""The command line, one module a command."""

from __future__ import annotations

from comparisons.cli.parser import main

__all__ = ["main"]
