"""How sessions are coloured: prompt and command apart from output, which may be anything."""

from __future__ import annotations

from typing import Any, ClassVar

from pygments.lexer import RegexLexer, bygroups
from pygments.token import Generic, Keyword, Text
from sphinx.application import Sphinx


class SessionLexer(RegexLexer):
    """A shell session: lines behind ``$`` are commands, all others output."""

    name = "Session"
    aliases: ClassVar = ["console"]
    tokens: ClassVar = {
        "root": [
            (r"^(\$ )(.*\\\n)", bygroups(Generic.Prompt, Keyword), "command"),
            (r"^(\$ )(.*\n)", bygroups(Generic.Prompt, Keyword)),
            (r".+", Generic.Output),
            (r"\n", Text),
        ],
        "command": [(r".*\\\n", Keyword), (r".*\n", Keyword, "#pop")],
    }


def setup(app: Sphinx) -> dict[str, Any]:
    """Take it for blocks in ``console``."""
    app.add_lexer("console", SessionLexer)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
