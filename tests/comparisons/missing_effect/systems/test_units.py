"""Functional mock-up units: one of C, compiled here, in FMI 2 and FMI 3."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
import system_models as make
import system_truths as truth

from comparisons.missing_effect.systems.diagnosis import diagnose_model
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.roles import measured_as, rates_of
from comparisons.missing_effect.systems.structure import Structure
from surge_core.errors import InputError

fmpy = pytest.importorskip("fmpy", reason="the extra 'fmu' is not installed")
FMU2Model = pytest.importorskip("fmpy.fmi2").FMU2Model
FMU3Model = pytest.importorskip("fmpy.fmi3").FMU3Model
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")

# Name, causality and variability, value reference, unit, start.
VARIABLES = (
    ("body.x", "local", "continuous", 0, "m", "0.05"),
    ("body.v", "local", "continuous", 1, "m/s", "0"),
    ("F", "input", "continuous", 2, "N", "0"),
    ("c", "parameter", "fixed", 3, "N.s/m", "1.5"),
    ("k", "parameter", "fixed", 4, "N/m", "80"),
    ("b", "parameter", "fixed", 5, "m", "0"),
    ("y", "output", "continuous", 6, "m", None),
    ("der(body.x)", "local", "continuous", 7, "m/s", None),
    ("der(body.v)", "local", "continuous", 8, "m/s2", None),
)


def described(version: int, kind: str = "ModelExchange", events: int = 0) -> str:
    """The description of the unit."""
    lines, three = [], version == 3
    for name, causality, variability, reference, unit, start in VARIABLES:
        limits = ' min="0.01" max="500"' if name in ("c", "k") else ""
        begin = "" if start is None else f' start="{start}"'
        initial = ' initial="exact"' if start is not None and causality == "local" else ""
        slope = {7: 0, 8: 1}.get(reference)
        of = "" if slope is None else f' derivative="{slope if three else slope + 1}"'
        head = f'name="{name}" valueReference="{reference}" causality="{causality}" '
        head += f'variability="{variability}"{initial}'
        lines.append(
            f'<Float64 {head} unit="{unit}"{begin}{limits}{of}/>'
            if three
            else f'<ScalarVariable {head}><Real unit="{unit}"{begin}{limits}{of}/></ScalarVariable>'
        )
    variables = "".join(lines)
    if three:
        structure = '<Output valueReference="6"/><ContinuousStateDerivative valueReference="7"/>'
        structure += '<ContinuousStateDerivative valueReference="8"/>'
        structure += '<EventIndicator valueReference="6"/>' * events
        token, count = 'fmiVersion="3.0" instantiationToken="1"', ""
    else:
        structure = '<Outputs><Unknown index="7"/></Outputs><Derivatives><Unknown index="8"/>'
        structure += '<Unknown index="9"/></Derivatives>'
        token, count = 'fmiVersion="2.0" guid="1"', f' numberOfEventIndicators="{events}"'
    return (
        f'<?xml version="1.0"?><fmiModelDescription {token} modelName="body"{count}>'
        f'<{kind} modelIdentifier="body"/><ModelVariables>{variables}</ModelVariables>'
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = Path(truth.__file__).with_name("mock_unit.c").read_text("utf-8")
    # A unit has all functions of the standard, also those that nothing here calls.
    for kind in (FMU2Model, FMU3Model):
        rest = [n for n in dir(kind) if n.startswith("fmi") and f"{n}(" not in text]
        text += "".join(f"int {name}(void) {{ return 3; }}\n" for name in rest)
    source = tmp_path_factory.mktemp("unit") / "body.c"
    source.write_text(text, "utf-8")
    assert COMPILER is not None
    made = source.with_suffix(".so")
    subprocess.run([COMPILER, "-shared", "-fPIC", "-O1", "-w", "-o", made, source], check=True)
    return made


def packed(library: Path, version: int, description: str | None = None) -> Path:
    """A unit of one version."""
    path = library.with_name(f"body{version}.fmu")
    folder = fmpy.platform if version == 2 else fmpy.platform_tuple
    inner = f"binaries/{folder}/body{fmpy.sharedLibraryExtension}"
    with zipfile.ZipFile(path, "w") as unit:
        unit.writestr("modelDescription.xml", description or described(version))
        unit.write(library, inner)
    return path


def spring(stiffening: float) -> dict[str, np.ndarray]:
    return truth.body(5, 800, force=lambda t, q, v: -stiffening * q**3, noise=0.01)


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_a_unit_is_a_model(version: int, library: Path) -> None:
    model = Model.from_fmu(
        packed(library, version), ["F"], {"q": "y"}, ["c", "k"], exact=("body_x",)
    )
    assert model.states == {"body_x": "m", "body_v": "m/s"}
    assert (model.name, model.inputs, model.outputs) == ("body", {"F": "N"}, {"q": "m"})
    assert model.params == {"c": P(1.5, 0.01, 500.0, "N.s/m"), "k": P(80.0, 0.01, 500.0, "N/m")}
    assert dict(model.x0) == {"body_x": 0.05, "body_v": 0.0}
    assert (rates_of(model), measured_as(model)) == ({0: (1, 1.0)}, {0: "q"})
    dx, y = model.evaluate(0.0, (0.2, 0.5), (3.0,), (2.0, 70.0))
    wanted = (3.0 - 2.0 * 0.5 - 70.0 * 0.2 - 600.0 * 0.2**3) / 2.0
    assert (dx, y) == ((0.5, pytest.approx(wanted)), (0.2,))
    own = make.body(
        params={n: model.params[n] for n in ("c", "k")},
        rhs=lambda t, x, u, p: (
            x.speed,
            (u.F - p.c * x.speed - p.k * x.at - 600.0 * x.at**3) / 2.0,
        ),
        balance={},
    )
    fits = []
    for one in (model, own):
        run = make.runs_on(one, [make.experiment("body", spring(600.0))])[0]
        structure = Structure(one, (), "cubic", 1e-7, offsets_free=False)
        fits.append(make.fitted(structure, [run], [3.0, 60.0, 0.0]))
    assert np.allclose(fits[0].theta, fits[1].theta, rtol=1e-5)
    assert np.allclose(fits[0].errors[0], fits[1].errors[0], atol=1e-5)
    assert fits[0].theta[:2] == pytest.approx([1.5, 80.0], rel=0.02)


@needs_compiler
def test_what_a_unit_lacks_is_named(library: Path) -> None:
    """The unit's spring hardens; the truth's body has a drag as well."""
    model = Model.from_fmu(
        packed(library, 2), ["F"], {"q": "y"}, {"c": P(1.0, 0.0, 20.0), "k": P(70.0, 5.0, 500.0)},
        exact=("body_x",),
    )  # fmt: skip
    made = truth.body(
        5, 600, force=lambda t, q, v: -600.0 * q**3 - 1.5 * np.tanh(v / 1e-3), noise=0.01
    )
    found = diagnose_model(model, make.experiment("body", made), most_effects=1)
    assert "coulomb_friction" in found.missing[0].alias_set
    assert found.missing[0].place["equation"] == "dbody_v/dt"


@needs_compiler
@pytest.mark.parametrize(
    ("version", "kind", "events", "words"),
    [
        (2, "ModelExchange", 3, "without events, .* found 3 event indicators"),
        (3, "ModelExchange", 1, "without events, .* found 1 event indicators"),
        (2, "CoSimulation", 0, "for model exchange, .* found co-simulation, of FMI 2.0"),
    ],
)
def test_a_unit_that_cannot_be_used_is_refused(
    version: int, kind: str, events: int, words: str, library: Path
) -> None:
    path = packed(library, version, described(version, kind, events))
    with pytest.raises(InputError, match=words) as caught:
        Model.from_fmu(path, ["F"], ["y"], ["c"])
    assert "\n" not in str(caught.value)


@needs_compiler
def test_variables_that_a_unit_lacks_are_refused(library: Path, tmp_path: Path) -> None:
    path = packed(library, 2)
    with pytest.raises(InputError, match=r"inputs: expected real variables .* found 'G'"):
        Model.from_fmu(path, ["G"], ["y"], ["c"])
    with pytest.raises(InputError, match=r"params: b: expected P.*, found no start and bounds"):
        Model.from_fmu(path, ["F"], ["y"], ["b"])
    with pytest.raises(InputError, match="expected a functional mock-up unit, found no such file"):
        Model.from_fmu(tmp_path / "none.fmu", ["F"], ["y"], ["c"])
    part = library.with_name("part.so")
    part.write_bytes(library.read_bytes().replace(b"fmi3Terminate", b"fmi3terminate"))
    with pytest.raises(InputError, match=r"with all functions of FMI.*: fmi3Terminate"):
        Model.from_fmu(packed(part, 3), ["F"], ["y"], ["c"])
