"""No result goes over what it was computed from, nor over any file of a recording."""

from __future__ import annotations

import codecs
import shutil
from pathlib import Path

import pytest

from imufield.cli.run import run
from imufield.deliver.samples.export_data import FORMATS
from imufield.errors import Reason
from tests.commands.told import fails

USAGE = 2
ENDS = (" choose another output.", " choose a new file.", " choose a folder.", " in an existing folder.")


@pytest.fixture
def folder(solved_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(solved_session, tmp_path / "S")
    (tmp_path / "ok.csv").write_text("ax,ay,az\n" + "".join(f"{k},{k % 3},{k % 2}\n" for k in range(9)))
    (tmp_path / "link").symlink_to(tmp_path / "S" / "part-001.mcap")
    (tmp_path / "hard").hardlink_to(tmp_path / "S" / "part-001.mcap")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("[!.]*")) if path.is_file()}


@pytest.mark.parametrize(
    "line",
    [
        "export-data S -o S/part-001.mcap",
        "export-data S -o link",
        "export-data S -o hard",
        *(f"export-data S -o ok.csv --to {to}" for to in FORMATS),
        "apply S/parameters.toml S -o ok.csv",
        "apply S/parameters.toml S -o S/part-001.mcap",
        "apply S/parameters.toml ok.csv -o ok.csv",
        "apply S/parameters.toml ok.csv -o S/parameters.toml",
        "report S --output S/part-001.mcap",
        "report S --record S/session.toml",
        "report S --output S/parameters.toml",
        "export S/parameters.toml --to c -o S/part-001.mcap",
        "export S/parameters.toml --to c -o S/parameters.toml",
        "verify S/parameters.toml S --output S/part-001.mcap",
        "verify S/parameters.toml S --output S/parameters.toml",
        "noise S -o S/part-001.mcap",
        "history S --csv S/parameters.toml",
        "history S --csv S/session.toml",
        "emulate stim300 --truth ok.csv",
        "emulate stim300 --truth S/session.toml",
        "study bsas-table1 --document S/parameters.toml",
        "study bsas-table1 --document S/session.toml",
        "study bsas-table1 --document nowhere/study.md",
        "study bsas-table1 --output ok.csv",
        "solve --observations ok.csv --output ok.csv",
        "solve S --output S/session.toml",
        "solve S --output S/part-001.mcap",
        "solve S --output hard",
    ],
)
def test_what_was_recorded_stays(folder: Path, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(folder)
    assert run(line.split()) == USAGE
    assert contents(folder) == before
    assert capsys.readouterr().err.strip().splitlines()[-1].endswith(ENDS)


@pytest.mark.parametrize(
    ("name", "package", "begins"),
    [
        ("s.PARQUET", "pyarrow", b"PAR1"),
        ("s.h5", "h5py", b"\x89HDF"),
        ("s.hdf5", "h5py", b"\x89HDF"),
        ("s.mcap", "mcap", b"\x89MCAP"),
        ("s.txt", "numpy", b"time_s,ax,"),
        ("s.parquet --to csv", "numpy", b"time_s,ax,"),
        ("s.overview.csv", "numpy", b"time_s,ax_min,"),
    ],
)
def test_the_name_tells_the_format(folder: Path, name: str, package: str, begins: bytes) -> None:
    pytest.importorskip(package)
    assert run(["export-data", "S", "-o", *name.split()]) == 0
    assert (folder / name.split(maxsplit=1)[0]).read_bytes().startswith(begins)


def test_corrected_samples_are_text_and_replace_their_like(folder: Path) -> None:
    fails("apply S/parameters.toml S -o s.parquet", USAGE, Reason.USAGE, key="apply.other_format")
    assert not (folder / "s.parquet").exists()
    for _ in range(2):
        if (folder / "s.csv").exists():
            # As a spreadsheet saves it.
            content = (folder / "s.csv").read_bytes().replace(b"\n", b"\r\n")
            (folder / "s.csv").write_bytes(codecs.BOM_UTF8 + content)
        assert run(["apply", "S/parameters.toml", "S", "-o", "s.csv"]) == 0
        assert run(["export-data", "S", "-o", "s.csv"]) == 0


def test_the_truth_of_an_emulation_before_is_replaced(folder: Path) -> None:
    line = "emulate stim300 --truth truth.toml --duration-s 0.1 --positions none"
    assert run(line.split()) == 0
    (folder / "truth.toml").write_text((folder / "truth.toml").read_text().replace("seed = 0", "seed = 7"))
    assert run(line.split()) == 0
    assert "seed = 7" not in (folder / "truth.toml").read_text()


def test_the_document_of_a_study_before_is_replaced(folder: Path) -> None:
    for name in ("bsas-table1", "ide-table1"):
        assert run(["study", name, "--document", "study.md"]) == 0
    assert "ide-table1" in (folder / "study.md").read_text(encoding="utf-8")


def test_a_solve_into_the_parameters_compared_with_keeps_them(folder: Path) -> None:
    old = (folder / "S" / "parameters.toml").read_bytes()
    assert run(["solve", "S", "--preset", "S/parameters.toml"]) == 0
    assert (folder / "S" / "parameters-1.toml").read_bytes() == old
