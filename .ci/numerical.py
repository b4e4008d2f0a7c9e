"""Run the tests marked ``numerical`` and not ``statistical`` with the oldest kernels that this processor can run.

``python .ci/numerical.py``: OpenBLAS's oldest core type, with NumPy's choice of kernels switched off too. Those that the
processor takes by itself are left to ``make test``. That the kernels were taken is read from the libraries, so that a new name
cannot make this run the same tests again. The rooms go side by side, one for each core.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import platform
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parent.parent
CORE_NAME = "OPENBLAS_CORETYPE"
OLDEST = "Prescott"
OLDEST_NAMES = {"Prescott", "Katmai"}  # Its kernels have one name for all the processors they serve.
FEATURES_OFF = "NPY_DISABLE_CPU_FEATURES"
LONGEST_S = 1200  # A room takes about 30 s, beside the tests some minutes; one that hangs must not take all that CI has.


class Kernels(NamedTuple):
    """What the libraries chose in a process."""

    openblas: list[str]  # of NumPy and of SciPy, which bring a library each
    numpy: list[str]  # the groups of instructions that are switched on, of those NumPy can choose between


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


def kernels_with(variables: dict[str, str]) -> Kernels:
    """Return what the libraries choose with these variables."""
    command = [sys.executable, __file__, "--kernels"]
    answer = subprocess.run(command, env=os.environ | variables, check=True, capture_output=True, text=True)
    return Kernels(*json.loads(answer.stdout))


def oldest_kernels() -> dict[str, str]:
    """Return the variables that choose the oldest kernels, once the libraries are seen to follow.

    Raises
    ------
    SystemExit
        If a library has not taken what it was told.
    """
    usual = kernels_with({})
    print(f"by itself this processor takes OpenBLAS {usual.openblas}, NumPy {usual.numpy}")
    variables = {}
    if usual.openblas and platform.machine() == "x86_64":
        variables[CORE_NAME] = OLDEST
    if usual.numpy:
        variables[FEATURES_OFF] = " ".join(usual.numpy)
    taken = kernels_with(variables)
    print(f"with {variables} OpenBLAS {taken.openblas}, NumPy {taken.numpy}")
    if taken.numpy or (CORE_NAME in variables and not set(taken.openblas) <= OLDEST_NAMES):
        sys.exit("not taken")
    return variables


def marked() -> dict[str, list[str]]:
    """Return the files with marked tests by room: others need not be collected."""
    found: dict[str, list[str]] = {}
    for path in sorted((PROJECT / "tests").rglob("test_*.py")):
        if "mark.numerical" in path.read_text(encoding="utf-8"):
            name = path.relative_to(PROJECT)
            found.setdefault(name.parts[1], []).append(str(name))
    return found


def do(variables: dict[str, str], room: str, files: list[str]) -> bool:
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
        env=os.environ | variables,
        timeout=LONGEST_S,
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    lines = ended.stdout.splitlines()
    shown = lines if ended.returncode else lines[-1:]
    print("\n".join([f"{room}: {time.monotonic() - begin_s:.0f} s", *shown]), flush=True)
    return ended.returncode == 0


def main() -> int:
    """Return 1 if a test fails with these kernels."""
    variables = oldest_kernels()
    with ThreadPoolExecutor(os.cpu_count()) as workers:
        passed = list(workers.map(lambda room: do(variables, *room), marked().items()))
    return int(not all(passed))


if __name__ == "__main__":
    if "--kernels" in sys.argv:
        print(json.dumps(chosen_kernels()))
        sys.exit()
    sys.exit(main())
