"""What libraries that write tables do to Ctrl-C."""

from __future__ import annotations

import signal
import threading
import weakref
from pathlib import Path

import pytest

from imufield.deliver.samples.export_tables import write_hdf5
from tests.deliver.samples.test_export_data import block

ROWS = 100


class Freed:
    """What h5py frees within a write, with a callback."""


def test_an_interrupt_that_falls_into_a_callback_of_h5py_is_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    h5py = pytest.importorskip("h5py")
    resize = h5py.Dataset.resize
    main = threading.main_thread().ident
    assert main is not None

    def resize_with_callback(self: object, *arguments: object, **options: object) -> None:
        freed = Freed()
        kept = weakref.ref(freed, lambda _: signal.pthread_kill(main, signal.SIGINT))
        del freed
        assert kept() is None
        resize(self, *arguments, **options)

    monkeypatch.setattr(h5py.Dataset, "resize", resize_with_callback)
    path = tmp_path / "samples.h5"
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            write_hdf5([block(ROWS), block(ROWS)], path, {})
    finally:
        signal.signal(signal.SIGINT, before)
    with h5py.File(path) as file:
        assert {len(column) for column in file.values()} == {ROWS}
