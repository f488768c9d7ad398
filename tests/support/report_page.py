"""A report with its own script taken off, once that is the only one and the one that it may run."""

from __future__ import annotations

import base64
import hashlib
import html
import re


def without_own_script(page: str) -> str:
    """Return a page without its script; every test for foreign ones then holds for the rest.

    Parameters
    ----------
    page : str
        A report.
    """
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', page)
    allowed = dict(rule.strip().split(" ", 1) for rule in html.unescape(policy).split(";"))
    assert allowed["default-src"] == "'none'"
    assert allowed["img-src"] == "data:"
    for tag, rule in (("style", "style-src"), ("script", "script-src")):
        (content,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        assert len(re.findall(rf"<{tag}\b", page)) == 1
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert allowed[rule] == f"'sha256-{digest}'"
    return re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
