"""Run the benchmarks, each in a process of its own, and write down what they measured: ``make bench``.

``python -m benchmarks apply decode`` runs two of them, without names all. Every figure goes into ``benchmarks/history.csv``,
and the newest of each into ``docs/benchmarks.md``, with the figure of a peer where one was measured in the same run.
What is more than 20 % worse than in the run before on the same machine is named.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.ledger import PAGE, Figure, Ledger, describe_machine, regressions, write_page
from imufield.campaign import BLAS_VARIABLES

FOLDER = Path(__file__).parent


def run_one(name: str) -> tuple[list[Figure], str] | None:
    """Return figures and printed text of a benchmark, None where it failed."""
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder) / "rows.json"
        command = [sys.executable, "-m", "benchmarks.collect", name, str(rows)]
        # One thread, as imufield itself has it: others only wait for each other, and that counts as processor time.
        environment = {**os.environ, **dict.fromkeys(BLAS_VARIABLES, "1")}
        ended = subprocess.run(command, cwd=FOLDER.parent, env=environment, check=False, stdout=subprocess.PIPE, text=True)
        if ended.returncode or not rows.exists():
            return None
        return [Figure(name, **row) for row in json.loads(rows.read_text(encoding="utf-8"))], ended.stdout


def main(names: list[str]) -> int:
    """Return 0 if every benchmark ran; how fast is told, never judged here."""
    known = sorted(path.stem.removeprefix("bench_") for path in FOLDER.glob("bench_*.py"))
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"there is no benchmark {', '.join(unknown)}; choose from {', '.join(known)}")
        return 2
    ledger, failed = Ledger.read(), []
    for name in names or known:
        machine = describe_machine()
        print(f"\n== {name}  ({machine.load})", flush=True)
        found = run_one(name)
        if found is None:
            failed.append(name)
            continue
        figures, text = found
        print(text or "\n".join(str(figure) for figure in figures), flush=True)
        for sentence in regressions(ledger, machine, figures):
            print(f"  slower: {sentence}")
        ledger.add(machine, name, figures, text)
        # After each, so that an interrupt keeps what is there.
        ledger.write()
        write_page(ledger)
    print(f"\nwritten to {PAGE}" + (f"; failed: {', '.join(failed)}" if failed else ""))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
