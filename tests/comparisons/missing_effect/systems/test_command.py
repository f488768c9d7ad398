"""`sindy-surge diagnose --model` and the runner of scripts: files, exit codes, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from driven_mass import CUBIC, MODEL, NOISE_M, files

from comparisons.cli import main


def run(*arguments: object) -> int:
    return main(["diagnose", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    return files(tmp_path_factory.mktemp("made"))


def test_the_command_names_what_a_model_lacks(
    made: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, train, check = made
    numbers, page = tmp_path / "numbers.json", tmp_path / "page.html"
    options = ("--json", numbers, "--report", page, "--max-effects", 1)
    assert run("--model", model, "--fit", train, "--check", check, *options) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert said.out.endswith(f"numbers: {numbers}\nreport: {page}\n")
    assert "cubic" in page.read_text("utf-8")
    document = json.loads(numbers.read_text("utf-8"))
    assert said.out.startswith(f"VERDICT: {document['verdict']}")
    (item,) = document["missing"]
    assert item["effect"] == "cubic_stiffness"
    assert item["place"] == {"equation": "dv/dt", "signal": "q"}
    (number,) = item["parameters"]
    assert abs(abs(number["value"]) - CUBIC) < 4.0 * number["stderr"]
    assert number["unit"].startswith("N/")
    assert [row["fate"] for row in document["candidates"]].count("added") == 1
    gap, errors = document["gap"], document["test_rmse"]["check"]
    assert gap["unit"] == errors["unit"] == "m"
    for which in ("before", "after"):
        assert gap[f"{which}_rms"] == pytest.approx(errors[which], rel=1e-12)
    for which in ("after", "floor"):
        assert gap[f"{which}_rms"] == pytest.approx(NOISE_M, rel=0.1)
    assert gap["before_rms"] > 50.0 * NOISE_M
    assert 0.99 < gap["shrink"] <= 1.0
    assert {row["record"] for row in document["where"]["time"]} == {"check"}
    assert "diagnoses" not in document


OWN = ("--model", "model.py", "--fit", "train.csv")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "expected SERIES of a compressor, or --model"),
        (("train.csv", "--check", "short.csv"), "--check: expected it only with --model"),
        (("--model", "model.py"), "or --model model.py --fit"),
        (("train.csv", *OWN), "SERIES: expected it only without --model"),
        ((*OWN, "--degree", 2), "--degree: expected it only without --model"),
        ((*OWN, "--check", "train.csv"), "train.csv: expected each record once"),
        ((*OWN, "--json", "train.csv"), "train.csv: expected a file of its own"),
        ((*OWN, "--json", "no/n.json"), "an existing folder"),
        (("--model", "no.py", "--fit", "train.csv"), "no.py: expected a file that exists"),
        (("--model", "model.py", "--fit", "no.csv"), "no.csv: expected a file that exists"),
        ((*OWN, "--check", "short.csv"), "short.csv: rows: expected at least 40"),
        (("--model", "bad.py", *OWN[2:]), "model: output: expected arithmetic"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(
    made: tuple[Path, Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[object, ...],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    record = made[1].read_text("utf-8")
    content = {
        "model.py": MODEL,
        "bad.py": MODEL.replace("return x.q\n", "return eval('x.q')\n"),
        "train.csv": record,
        "short.csv": "\n".join(record.splitlines()[:20]),
    }
    for name, text in content.items():
        (tmp_path / name).write_text(text, "utf-8")
    assert run(*options) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("sindy-surge: ")
    assert words in said.err
    assert said.err.count("\n") == 1
    assert {path.name: path.read_text("utf-8") for path in tmp_path.iterdir()} == content
