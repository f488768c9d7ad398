"""How the documentation is built: `make docs`; nothing is fetched."""

from __future__ import annotations

import importlib
import sys
from functools import cache
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

from public import documented  # noqa: E402

project = "sindy-surge"
author = "sindy-surge"
release = installed_version("sindy-surge")
version = release
language = "en_GB"

extensions = [
    "mathml",
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
root_doc = "index"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
templates_path = ["_templates"]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
html_theme = "alabaster"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_title = "sindy-surge"
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_show_copyright = False
toc_object_entries = False
# Names in single backticks, as docstrings have them.
default_role = "literal"
html_theme_options = {
    "description": "Post-stall characteristics and time constants from surge records",
    "fixed_sidebar": True,
    "page_width": "1240px",
    "sidebar_width": "250px",
    "font_family": "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif",
    "head_font_family": "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif",
    "code_font_family": "ui-monospace, 'DejaVu Sans Mono', monospace",
    "show_powered_by": False,
    "sidebar_collapse": True,
}

autosummary_generate = True
autosummary_imported_members = False
autodoc_member_order = "bysource"
# The sections of a docstring say types with shapes and units; a signature says them worse.
autodoc_typehints = "none"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
# The sections say type, shape and unit in words; as fields each word would be taken for a class.
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]


@cache
def _public_names() -> dict[str, str]:
    """Return, for each object that is documented, its own path and the name it has in public."""
    out = {}
    for name in documented():
        home, _, last = name.rpartition(".")
        thing = getattr(importlib.import_module(home), last)
        own = getattr(thing, "__module__", None), getattr(thing, "__qualname__", None)
        if all(own):
            out[".".join(own)] = name
    return out


def _public_name(target: str, doc: str) -> str | None:
    """Return the documented name of what a docstring calls by its own path or by its last name."""
    if target in _public_names():
        return _public_names()[target]
    same = [name for name in documented() if name.endswith(f".{target}")]
    near = [name for name in same if name.partition(".")[0] in doc]
    return (near or same or [None])[0]


def _resolve(app: Any, env: Any, node: Any, contnode: Any) -> Any:
    """Link what is documented under another path."""
    if node.get("refdomain") != "py":
        return None
    target, doc = node["reftarget"], node["refdoc"]
    public = _public_name(target, doc)
    if public is not None and public != target:
        domain = env.get_domain("py")
        return domain.resolve_xref(env, doc, app.builder, "obj", public, node, contnode)
    return None


# Stands for a colon while napoleon looks at a property: it takes what is before one for a type.
_COLON = "\ue000"


def _hide_colons(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    if what in ("property", "attribute") and lines:
        lines[0] = lines[0].replace(":", _COLON)


def _restore(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Bring colons back, and link the error that is raised."""
    for i, line in enumerate(lines):
        restored = line.replace(_COLON, ":")
        lines[i] = restored.replace(":raises InputError:", ":raises ~classic_ml.InputError:")


def setup(app: Any) -> None:
    """Register what is above."""
    app.connect("missing-reference", _resolve)
    app.connect("autodoc-process-docstring", _hide_colons, priority=400)
    app.connect("autodoc-process-docstring", _restore, priority=600)
