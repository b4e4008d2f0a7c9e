import os
import stat
from pathlib import Path

import pytest

from imufield.files import keep_previous, read_small_file, write_atomically


def test_content_is_replaced_and_nothing_else_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    write_atomically(path, b"old")
    path.chmod(0o640)
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert [file.name for file in tmp_path.iterdir()] == ["a.toml"]


def test_a_new_file_has_the_usual_permissions(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        write_atomically(tmp_path / "a.toml", b"x")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "a.toml").stat().st_mode) == 0o640


def test_a_failure_leaves_the_old_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.toml"
    write_atomically(path, b"old")

    def refuse(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="No space"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.toml"]


def test_previous_results_are_numbered(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    assert keep_previous(path) is None
    for number, content in enumerate(("one", "two"), start=1):
        path.write_text(content)
        kept = keep_previous(path)
        assert kept == tmp_path / f"parameters-{number}.toml"
        assert kept.read_text() == content
    assert not path.exists()


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a file without end")
def test_a_file_without_end_is_not_read_whole() -> None:
    with pytest.raises(OSError, match="larger than 16777216 bytes"):
        read_small_file("/dev/zero")


def test_a_small_file_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "small").write_bytes(b"a\x00b")
    assert read_small_file(tmp_path / "small") == b"a\x00b"
