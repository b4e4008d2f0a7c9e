import errno
import os
import stat
from pathlib import Path

import pytest

from imufield.errors import ParameterFileError, Reason, RecordingError
from imufield.files import keep_previous, read_small_file, typed_write_errors, write_atomically, write_error


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
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
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
    with pytest.raises(OSError, match="16777216 bytes"):
        read_small_file("/dev/zero")


def test_a_small_file_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "small").write_bytes(b"a\x00b")
    assert read_small_file(tmp_path / "small") == b"a\x00b"


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.ENOSPC, Reason.DISK_FULL),
        (errno.EDQUOT, Reason.DISK_FULL),
        (errno.EFBIG, Reason.DISK_FULL),
        (errno.EACCES, Reason.NO_PERMISSION),
        (errno.EPERM, Reason.NO_PERMISSION),
        (errno.EROFS, Reason.NO_PERMISSION),
        (errno.ENOENT, Reason.FOREIGN),
        (errno.ENOTDIR, Reason.FOREIGN),
        (errno.EISDIR, Reason.FOREIGN),
        (errno.EEXIST, Reason.FOREIGN),
        (errno.ENAMETOOLONG, Reason.USAGE),
        (errno.EIO, Reason.DAMAGED),
    ],
    ids=lambda value: errno.errorcode[value] if isinstance(value, int) else "",
)
def test_what_a_failed_write_means(number: int, reason: Reason) -> None:
    failed = OSError(number, os.strerror(number))
    for kind in (ParameterFileError, RecordingError):
        error = write_error("a/b.toml", failed, kind, advice="; resume")
        assert type(error) is kind
        assert (error.reason, error.values["path"], error.values["errno"]) == (reason, "a/b.toml", number)
        assert "a/b.toml" in error.message
        assert os.strerror(number) in error.message
        assert error.message.endswith("; resume")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder in which nobody can make files")
def test_a_place_that_takes_no_files_is_no_full_disk() -> None:
    with pytest.raises(ParameterFileError) as caught, typed_write_errors("/proc/nowhere.txt"):
        write_atomically("/proc/nowhere.txt", b"x")
    assert caught.value.reason is Reason.FOREIGN


def test_a_real_place_in_each_state(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    places = {
        tmp_path: Reason.FOREIGN,
        tmp_path / "file" / "below": Reason.FOREIGN,
        tmp_path / "gone" / "below": Reason.FOREIGN,
        tmp_path / ("n" * 300): Reason.USAGE,
    }
    for place, reason in places.items():
        with pytest.raises(RecordingError) as caught, typed_write_errors(place, RecordingError):
            write_atomically(place, b"x")
        assert caught.value.reason is reason, place
