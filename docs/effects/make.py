"""Write what the code says of each effect into its page: equation, parameters, advice.

    python docs/effects/make.py [--check]

A page holds blocks between `% made: NAME` and `% end`; the prose around them stays as it is. With
`--check` nothing is written, and the pages that differ are listed.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from comparisons.missing_effect import CATALOGUE, SYSTEM_CATALOGUE, SystemEffect
from comparisons.missing_effect.catalogue import FLOW_NOISE, find_effect
from comparisons.missing_effect.systems.shapes import Kind

HERE = Path(__file__).parent
BLOCK = re.compile(r"^% made: (\w+)\n(.*?)^% end\n", re.MULTILINE | re.DOTALL)
# Beyond this a bound only keeps a search within the machine's numbers.
NO_BOUND = 1e300
FOUND = {"linear": "solved", "free": "searched", "held": "of a few values"}
COLUMNS = ("T25_K", "Nc_frac", "in_stall")
PLACES = {
    Kind.TERM: "an equation that is not exact",
    Kind.HYSTERESIS: "an equation that is not exact",
    Kind.INPUT_MAP: "an input",
    Kind.INPUT_DELAY: "an input",
    Kind.INPUT_LAG: "an input",
    Kind.INPUT_PLAY: "an input",
    Kind.STATE_LIMIT: "a state, where it acts on the others",
    Kind.OUTPUT_MAP: "a sensor",
    Kind.OUTPUT_LAG: "a sensor",
    Kind.OVERFLOW: "a state that is a level, lost or into another of its unit",
    Kind.RECORDING: "all channels alike",
    Kind.DRIFT: "a parameter",
}
# What the bounds of a number are in units of, by kind and slot.
RMS, RATE = "the rms of its signal", "the rms of the derivative"
SCALES: dict[Kind, tuple[str, ...]] = {
    Kind.TERM: (RATE, RMS, "1"),
    Kind.HYSTERESIS: (RATE, "rms × a time of the signal", "1"),
    Kind.INPUT_MAP: (RMS,),
    Kind.INPUT_PLAY: (RMS,),
    Kind.INPUT_DELAY: ("samples",),
    Kind.INPUT_LAG: ("samples",),
    Kind.STATE_LIMIT: (RMS,),
    Kind.OUTPUT_MAP: (RMS,),
    Kind.OUTPUT_LAG: ("samples",),
    Kind.OVERFLOW: (RMS, "1"),
    Kind.RECORDING: ("samples", "samples²"),
    Kind.DRIFT: ("the parameter (of either sign: its nearer bound), over half the records' span",),
}


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def bounds_of(low: float, high: float) -> str:
    """Return bounds in words."""
    low_text, high_text = (f"{x:g}".replace("-", "−").replace("e+0", "e") for x in (low, high))
    if abs(high) > NO_BOUND:
        return "any" if abs(low) > NO_BOUND else f"from {low_text} on"
    return f"{low_text} to {high_text}"


def sentence(words: str) -> str:
    """Return words as a sentence."""
    return (words[0].upper() + words[1:] if words[0].isascii() else words) + "."


def lag_blocks(name: str) -> dict[str, str]:
    """Return the blocks of an effect of the compressor's lag model."""
    effect = find_effect(name)
    rows = [
        (f"`{p.name}`", p.unit, bounds_of(p.low, p.high), FOUND[p.kind]) for p in effect.parameters
    ]
    needs = f"the column `{effect.needs}`" if effect.needs in COLUMNS else "φ and ψ' alone"
    head = f"**Port** {effect.port}. **Equation** {effect.equation}. **Needs** {needs}."
    return {
        "head": f"{head}\n\n{sentence(effect.says)}",
        "parameters": table(("parameter", "unit", "bounds", "found"), rows),
        "left_out": sentence(effect.on_tau),
        "confirm": sentence(effect.confirm),
    }


def equation_of(form: SystemEffect) -> str:
    """Return what a form adds, with the letters of the pages."""
    return form.equation.format(s="s", o="o", p="p")


def says_of(form: SystemEffect) -> str:
    """Return what happens, and what is said of it where nothing moves."""
    if form.neutral is None:
        return form.says
    title, says = form.neutral.title, form.neutral.says
    return f"{form.says} Where nothing moves, a {title}: {says[0].lower()}{says[1:]}"


def system_blocks(name: str) -> dict[str, str]:
    """Return the blocks of an effect of the general catalogue."""
    forms = [effect for effect in SYSTEM_CATALOGUE if effect.name == name]
    rows = [(equation_of(form), PLACES[form.kind], says_of(form)) for form in forms]
    numbers = [
        (
            f"`{n.name}`",
            equation_of(form) + f" ({PLACES[form.kind].partition(',')[0]})" * (len(forms) > 1),
            bounds_of(0.0 - n.high, -n.low)
            if form.resists and slot == 0
            else bounds_of(n.low, n.high),
            "1" if n.name == "exponent" else SCALES[form.kind][slot],
        )
        for form in forms
        for slot, n in enumerate(form.numbers)
    ]
    simple = dict.fromkeys(other for form in forms for other in form.simple_form_of)
    plain = ", ".join(f"[`{other}`]({other}.md)" for other in simple)
    confirm = dict.fromkeys(form.confirm for form in forms)
    return {
        "forms": table(("it adds", "it may sit at", "what happens"), rows),
        "numbers": table(("number", "of", "bounds", "in units of"), numbers)
        if numbers
        else "It has no numbers.",
        "confirm": "\n".join(f"- {sentence(words)}" for words in confirm)
        + (f"\n\nIt is the plain form of {plain}." if plain else ""),
    }


def pages() -> dict[Path, dict[str, str]]:
    """Return the blocks of every page."""
    lag = [*CATALOGUE, FLOW_NOISE]
    system = dict.fromkeys(effect.name for effect in SYSTEM_CATALOGUE)
    out = {HERE / f"{effect.name}.md": lag_blocks(effect.name) for effect in lag}
    out |= {HERE / "systems" / f"{name}.md": system_blocks(name) for name in system}
    rows = [(e.port, f"[`{e.name}`]({e.name}.md)", e.equation, e.says) for e in lag]
    out[HERE / "index.md"] = {"table": table(("port", "effect", "equation", "what happens"), rows)}
    rows = [
        (f"[`{name}`]({name}.md)", equation_of(form), PLACES[form.kind])
        for name in system
        for form in SYSTEM_CATALOGUE
        if form.name == name
    ]
    heads = ("effect", "it adds", "it may sit at")
    out[HERE / "systems" / "index.md"] = {"table": table(heads, rows)}
    return out


def with_blocks(text: str, made: Mapping[str, str]) -> str:
    """Return a page's text with its blocks replaced."""

    def put(found: re.Match[str]) -> str:
        return f"% made: {found[1]}\n\n{made[found[1]]}\n\n% end\n"

    return BLOCK.sub(put, text)


def main() -> int:
    """Write the pages, or compare them."""
    differ = []
    for page, made in pages().items():
        text = page.read_text("utf-8")
        new = with_blocks(text, made)
        if new != text:
            differ.append(page)
        if "--check" not in sys.argv:
            page.write_text(new, "utf-8")
    sys.stdout.write("".join(f"{page.relative_to(HERE)} differs\n" for page in differ))
    return int(bool(differ) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
