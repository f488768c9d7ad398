"""What a notebook shows of diagnoses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from made_diagnosis import VERDICTS, made_diagnosis
from made_pages import EVIL

from comparisons.missing_effect.quantities import plain_name
from surge_core.rounding import bracketed


def shown(value: Any) -> tuple[str, str]:
    """Return text and HTML, the second without what may run or load anything."""
    text, html = str(value), value._repr_html_()
    assert value._repr_mimebundle_() == {"text/plain": text, "text/html": html}
    for tag in ("<script", "<img", "<link", "<svg", 'onerror="', "url("):
        assert tag not in html
    assert html.startswith('<div class="sindy-surge"><style>')
    assert len(html) < 40_000
    return text, html


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_diagnosis_shows_its_verdict_and_what_it_does_to_the_lag(verdict: str) -> None:
    d = made_diagnosis(verdict)
    d = replace(d, data=replace(d.data, sources=(EVIL, "b.csv")))
    text, html = shown(d)
    assert verdict.replace("_", " ") in text.splitlines()[0]
    good = verdict in ("named", "nothing_missing", "alias_set")
    assert ('class="state"' in html) == good
    assert bracketed(d.tau_after_s, d.tau_stderr_s) in text
    for item in d.missing:
        assert " or ".join(map(plain_name, item.alias_labels[:2])) in text
