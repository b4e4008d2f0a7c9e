"""Run the tests marked ``numerical`` and not ``statistical`` with other kernels than those this processor takes by itself.

``python .ci/numerical.py``: once under each OpenBLAS core type that the processor can run; those that it takes by itself are
left to ``make test``. In the last of them, the oldest, NumPy's choice of kernels is switched off too. That a kernel was taken
is read from the libraries, so that a new name cannot make this run the same tests three times. The rooms of all runs go side
by side, one for each core.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parent.parent
OLDEST = "Prescott"
# What the kernels of a core type are compiled for, as /proc/cpuinfo names it ("pni" is SSE3).
CORE_TYPES = {
    "Haswell": {"avx2", "fma"},
    "SkylakeX": {"avx512f", "avx512dq", "avx512cd", "avx512bw", "avx512vl"},
    OLDEST: {"pni"},
}
# The oldest kernels have one name for all the processors they serve.
CORE_NAMES = {OLDEST: {"Prescott", "Katmai"}}
CORE_NAME = "OPENBLAS_CORETYPE"
FEATURES_OFF = "NPY_DISABLE_CPU_FEATURES"
LONGEST_S = 1200  # A room takes about 30 s, beside the tests some minutes; one that hangs must not take all that CI has.


class Kernels(NamedTuple):
    """What the libraries chose in a process."""

    openblas: list[str]  # of NumPy and of SciPy, which bring a library each
    numpy: list[str]  # the groups of instructions that are switched on, of those NumPy can choose between


class Run(NamedTuple):
    """One way to run the tests."""

    variables: dict[str, str]

    def __str__(self) -> str:
        return " ".join(f'{name}="{value}"' for name, value in self.variables.items())

    @property
    def environment(self) -> dict[str, str]:
        """Return the variables of the process."""
        return {**os.environ, **self.variables}


def chosen_kernels() -> Kernels:
    """Return what the libraries chose in this process."""
    import numpy as np
    import scipy.linalg  # noqa: F401  (loads SciPy's OpenBLAS)

    umath = importlib.import_module("numpy._core._multiarray_umath")  # private, and without types

    names = []
    for folder in ("numpy.libs", "scipy.libs"):
        for path in sorted((Path(np.__file__).parent.parent / folder).glob("libscipy_openblas*")):
            library = ctypes.CDLL(str(path))
            suffix = "64_" if "openblas64_" in path.name else ""
            name = getattr(library, f"scipy_openblas_get_corename{suffix}")
            name.restype = ctypes.c_char_p
            names.append(name().decode())
    return Kernels(names, [group for group in umath.__cpu_dispatch__ if umath.__cpu_features__.get(group)])


def kernels_of(environment: dict[str, str]) -> Kernels:
    """Return what the libraries choose with these variables."""
    command = [sys.executable, __file__, "--kernels"]
    answer = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return Kernels(*json.loads(answer.stdout))


def runs() -> Iterator[Run]:
    """Yield the runs that this processor can do, each once the libraries are seen to follow.

    Raises
    ------
    SystemExit
        If a library has not taken what it was told.
    """
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text(encoding="utf-8") if cpuinfo.exists() else ""
    flags = next((set(line.split()) for line in text.splitlines() if line.startswith("flags")), set())
    usual = kernels_of(dict(os.environ))
    print(f"by itself this processor takes OpenBLAS {usual.openblas}, NumPy {usual.numpy}")
    # Alone where the oldest core type is not to be run.
    oldest = {FEATURES_OFF: " ".join(usual.numpy)} if usual.numpy else {}
    for name, needed in CORE_TYPES.items():
        run = Run({CORE_NAME: name})
        if not (usual.openblas and needed <= flags):
            print(f"{run}: not on this processor")
        elif set(usual.openblas) <= CORE_NAMES.get(name, {name}):
            print(f"{run}: taken by itself, so by `make test`")
        elif not set(kernels_of(run.environment).openblas) <= CORE_NAMES.get(name, {name}):
            sys.exit(f"{run} has not taken: OpenBLAS says {kernels_of(run.environment).openblas}")
        elif name == OLDEST:
            oldest |= run.variables
        else:
            yield run
    if oldest:
        last = Run(oldest)
        if kernels_of(last.environment).numpy:
            sys.exit(f"{last} has not taken: {kernels_of(last.environment).numpy} is still on")
        yield last


def marked() -> dict[str, list[str]]:
    """Return the files with marked tests by room: others need not be collected."""
    found: dict[str, list[str]] = {}
    for path in sorted((PROJECT / "tests").rglob("test_*.py")):
        if "mark.numerical" in path.read_text(encoding="utf-8"):
            name = path.relative_to(PROJECT)
            found.setdefault(name.parts[1], []).append(str(name))
    return found


def do(run: Run, room: str, files: list[str]) -> bool:
    """Run the marked tests of a room, print what they said; return whether they passed."""
    begin_s = time.monotonic()
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "--tb=short",
        "-m",
        "numerical and not statistical",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
    ]
    ended = subprocess.run(
        [*command, *files],
        cwd=PROJECT,
        env=run.environment,
        timeout=LONGEST_S,
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    lines = ended.stdout.splitlines()
    shown = lines if ended.returncode else lines[-1:]
    print("\n".join([f"{run} {room}: {time.monotonic() - begin_s:.0f} s", *shown]), flush=True)
    return ended.returncode == 0


def main() -> int:
    """Return 1 if a test fails with one of the kernels."""
    jobs = [(run, room, files) for (room, files), run in product(marked().items(), runs())]
    with ThreadPoolExecutor(os.cpu_count()) as workers:
        return int(not all(list(workers.map(do, *zip(*jobs, strict=True)))))


if __name__ == "__main__":
    if "--kernels" in sys.argv:
        print(json.dumps(chosen_kernels()))
        sys.exit()
    sys.exit(main())
