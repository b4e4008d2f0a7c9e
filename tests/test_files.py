import errno
import os
import stat
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from imufield import files
from imufield.errors import ParameterFileError, Reason, RecordingError
from imufield.files import (
    Origin,
    keep_previous,
    open_regular,
    open_to_read,
    publish_beside_others,
    read_small_file,
    refuse_overwriting,
    typed_write_errors,
    utf8_text,
    write_atomically,
    write_error,
    write_keeping,
)
from tests.refused import refused

NEEDS_PIPES = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with a name")


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
        assert kept is not None
        assert (kept, kept.read_text()) == (tmp_path / f"parameters-{number}.toml", content)
    assert not path.exists()


def test_what_another_program_keeps_at_the_same_time_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, others = tmp_path / "parameters.toml", tmp_path / "parameters-1.toml"
    path.write_text("ours")
    take = Path.touch

    def take_late(self: Path, **options: Any) -> None:
        others.write_text("theirs")
        take(self, **options)

    monkeypatch.setattr(Path, "touch", take_late)
    kept = keep_previous(path)
    assert kept is not None
    assert (others.read_text(), kept.read_text()) == ("theirs", "ours")
    # It was quicker with this one.
    path.write_text("ours")

    def take_too_late(self: Path, **options: Any) -> None:
        take(self, **options)
        path.unlink(missing_ok=True)

    monkeypatch.setattr(Path, "touch", take_too_late)
    assert keep_previous(path) is None
    assert {each.name for each in tmp_path.iterdir()} == {others.name, kept.name}


@pytest.fixture(params=[True, False], ids=["hard links", "no hard links"])
def file_systems(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Be on a file system with hard links, and on one without, as FAT is."""
    if not request.param:

        def refuse(*_: Any) -> None:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

        monkeypatch.setattr(os, "link", refuse)


@pytest.mark.usefixtures("file_systems")
def test_of_two_programs_that_write_at_once_both_results_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text("before")
    keep = files.keep_previous

    def keep_and_be_slow(path: Path) -> Path | None:
        kept = keep(path)
        if kept == tmp_path / "parameters-1.toml":
            path.write_text("theirs")
        return kept

    monkeypatch.setattr(files, "keep_previous", keep_and_be_slow)
    assert write_keeping(path, b"ours") == tmp_path / "parameters-2.toml"
    found = {each.name: each.read_text() for each in tmp_path.iterdir()}
    assert found == {"parameters.toml": "ours", "parameters-1.toml": "before", "parameters-2.toml": "theirs"}


def test_a_result_that_cannot_be_written_leaves_the_old_one_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text("before")
    link = os.link

    def refuse_new(source: Path, place: Path) -> None:
        if Path(source).suffix == ".new":
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        link(source, place)

    monkeypatch.setattr(os, "link", refuse_new)
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        write_keeping(path, b"ours")
    assert {each.name: each.read_text() for each in tmp_path.iterdir()} == {"parameters.toml": "before"}


@pytest.mark.skipif(os.name == "nt", reason="needs links")
def test_a_link_that_leads_nowhere_is_kept_as_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    path.symlink_to("parameters.toml")
    kept = write_keeping(path, b"ours")
    assert kept is not None
    assert kept.is_symlink()
    assert (path.read_bytes(), path.is_symlink()) == (b"ours", False)


def test_the_same_content_is_written_once_and_is_new(tmp_path: Path) -> None:
    path = tmp_path / "c.h"
    path.write_bytes(b"ours")
    os.utime(path, (1.0, 1.0))
    assert write_keeping(path, b"ours") is None
    assert path.stat().st_mtime > 1.0
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.usefixtures("file_systems")
def test_a_name_that_is_taken_gets_a_number(tmp_path: Path) -> None:
    path = tmp_path / "acc.csv"
    for number, name in enumerate(("acc.csv", "acc-1.csv", "acc-2.csv")):
        whole = tmp_path / "whole"
        whole.write_text(str(number))
        assert publish_beside_others(whole, path) == tmp_path / name
        assert (tmp_path / name).read_text() == str(number)
        assert not whole.exists()


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a file without end")
def test_a_file_without_end_is_not_read_whole() -> None:
    with pytest.raises(OSError, match="device"):
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
        # Of a folder its sentence says so in its own words.
        assert number == errno.EISDIR or os.strerror(number) in error.message
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


@NEEDS_PIPES
@pytest.mark.parametrize("origin", Origin)
def test_only_regular_files_are_opened(tmp_path: Path, origin: Origin) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for path in (tmp_path / "pipe", tmp_path / "link", Path("/dev/zero"), tmp_path):
        with pytest.raises(OSError, match=r"pipe or device|link|directory"):
            open_to_read(path, origin)


@pytest.mark.skipif(not Path("/proc/self/fd/1").exists(), reason="needs the files of a process")
def test_no_file_takes_the_place_of_a_link_to_standard_output(tmp_path: Path) -> None:
    link = tmp_path / "stdout"
    (tmp_path / "shell").touch()
    # Also where the shell has put a file there.
    with (tmp_path / "shell").open() as file:
        link.symlink_to(f"/proc/self/fd/{file.fileno()}")
        for path in (link, link.readlink()):
            with pytest.raises(OSError, match="pipe or device"):
                write_atomically(path, b"x")
    assert link.is_symlink()


def test_a_link_is_followed_where_a_person_or_the_user_s_own_place_has_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to("file")
    for origin in (Origin.TYPED, Origin.FOUND):
        assert read_small_file(tmp_path / "link", origin) == b"content"
    with pytest.raises(OSError, match="link") as caught:
        read_small_file(tmp_path / "link", Origin.INSIDE)
    assert caught.value.errno == errno.ELOOP


@pytest.mark.parametrize("flags", [os.O_RDWR, os.O_RDWR | os.O_CREAT, os.O_WRONLY | os.O_TRUNC])
def test_nothing_is_written_through_a_link(tmp_path: Path, flags: int) -> None:
    (tmp_path / "victim").write_bytes(b"kept")
    (tmp_path / "link").symlink_to("victim")
    (tmp_path / "dangling").symlink_to("not there")
    for name in ("link", "dangling"):
        with pytest.raises(OSError, match="link"):
            open_regular(tmp_path / name, flags, follow=False)
    assert (tmp_path / "victim").read_bytes() == b"kept"
    assert not (tmp_path / "not there").exists()


@NEEDS_PIPES
def test_a_pipe_that_a_person_names_is_read(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)

    def write() -> None:
        time.sleep(0.05)  # The reader is there first, as it may be in a shell.
        with path.open("wb") as pipe:
            for _ in range(3):
                pipe.write(b"abc" * 40000)

    writer = threading.Thread(target=write)
    writer.start()
    assert read_small_file(path) == b"abc" * 120000
    writer.join()


@NEEDS_PIPES
def test_a_silent_or_endless_pipe_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    monkeypatch.setattr(files, "PIPE_OPEN_LIMIT_S", 0.1)
    # Nobody is there who would write: not waited for as one who is.
    with pytest.raises(TimeoutError, match=r"0\.1 s"):
        read_small_file(path)
    monkeypatch.setattr(files, "PIPE_LIMIT_S", 0.2)
    # One that is open for writing and says nothing.
    both = os.open(path, os.O_RDWR)
    try:
        with pytest.raises(TimeoutError, match=r"0\.2 s"):
            read_small_file(path)
    finally:
        os.close(both)
    for origin in (Origin.FOUND, Origin.INSIDE):
        with pytest.raises(OSError, match="pipe"):
            read_small_file(path, origin)


def test_a_name_as_long_as_the_system_allows_is_written(tmp_path: Path) -> None:
    for name in ("n" * 255, "é" * 127):
        write_atomically(tmp_path / name, b"x")
        assert (tmp_path / name).read_bytes() == b"x"


def test_what_cannot_be_written_is_refused_before_it_is_computed(tmp_path: Path) -> None:
    with refused(ParameterFileError, Reason.FOREIGN, key="files.no_folder"):
        refuse_overwriting(tmp_path / "nowhere" / "a.toml")
    deep = tmp_path / "/".join(["d" * 200] * 25) / "a.toml"
    with refused(RecordingError, Reason.USAGE, key="files.long_name"):
        refuse_overwriting(deep, [], RecordingError)
    refuse_overwriting(tmp_path / "a.toml")
    assert not any(tmp_path.iterdir())


def test_a_name_of_any_bytes_becomes_text() -> None:
    name = os.fsdecode(b"caf\xe9-\xc3\xa9")
    assert utf8_text(name).encode() == "caf\ufffd-é".encode()
