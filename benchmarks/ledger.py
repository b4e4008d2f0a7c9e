"""What was measured, when, on what: the history as CSV, the page for people, and what became worse."""

from __future__ import annotations

import csv
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
HISTORY = PROJECT / "benchmarks" / "history.csv"
PRINTED = PROJECT / "benchmarks" / "printed"
PAGE = PROJECT / "docs" / "benchmarks.md"
WORSE = 1.2
"""Beyond this ratio to the run before, a figure is named."""
MORE_IS_BETTER = ("/s", "yes", " seeds")
"""Ends of units; all others (s, MiB, %) are the better the smaller."""
PACKAGES = ("numpy", "scipy", "pyserial", "python-can", "cantools", "mcap")


@dataclass(frozen=True, slots=True)
class Machine:
    """What it ran on. Runs are compared where ``key`` is the same."""

    processor: str
    cores: int
    memory_gib: int
    python: str
    packages: str
    load: str

    @property
    def key(self) -> str:
        """Processor, cores, Python."""
        return f"{self.processor}, {self.cores} cores, {self.memory_gib} GiB, Python {self.python}"


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of a benchmark."""

    benchmark: str
    what: str
    value: float
    unit: str
    peer: float | None = None

    def __str__(self) -> str:
        peer = "" if self.peer is None else f"   peer {self.peer:.4g} ({self.value / self.peer:.2f} times)"
        return f"{self.what:<62} {self.value:>10.4g} {self.unit}{peer}"

    @property
    def more_is_better(self) -> bool:
        """Whether a larger value is the better one."""
        return self.unit.endswith(MORE_IS_BETTER)


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the history."""

    date: str
    machine: str
    load: str
    benchmark: str
    what: str
    value: float
    unit: str
    peer: float | None


COLUMNS = [field.name for field in fields(Entry)]


@dataclass(slots=True)
class Ledger:
    """All runs so far, the newest last."""

    entries: list[Entry] = field(default_factory=list)
    packages: str = ""

    @classmethod
    def read(cls, path: Path = HISTORY) -> Ledger:
        """Read the history; an empty one where there is none."""
        if not path.exists():
            return cls()
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        return cls([_entry(row) for row in rows])

    def add(self, machine: Machine, benchmark: str, figures: list[Figure], printed: str) -> None:
        """Take the figures of a run, and what it printed where it has none."""
        date = datetime.now(UTC).strftime("%Y-%m-%d")
        self.packages = machine.packages
        for figure in figures:
            self.entries.append(
                Entry(date, machine.key, machine.load, benchmark, figure.what, figure.value, figure.unit, figure.peer)
            )
        if printed and not figures:
            PRINTED.mkdir(exist_ok=True)
            head = f"{date}, {machine.key}, {machine.load}\n"
            (PRINTED / f"{benchmark}.txt").write_text(head + printed, encoding="utf-8")

    def last(self, benchmark: str, what: str, machine: str | None = None) -> Entry | None:
        """Return the newest value of a figure, on one machine or on any."""
        for entry in reversed(self.entries):
            if (entry.benchmark, entry.what) == (benchmark, what) and machine in (None, entry.machine):
                return entry
        return None

    def write(self, path: Path = HISTORY) -> None:
        """Write the history."""
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for entry in self.entries:
                values = [getattr(entry, name) for name in COLUMNS]
                writer.writerow(
                    ["" if value is None else f"{value:.6g}" if isinstance(value, float) else value for value in values]
                )


def _written(value: str | float | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.6g}"


def _entry(row: dict[str, str]) -> Entry:
    peer = float(row["peer"]) if row["peer"] else None
    words = {name: row[name] for name in ("date", "machine", "load", "benchmark", "what", "unit")}
    return Entry(**words, value=float(row["value"]), peer=peer)


def describe_machine() -> Machine:
    """Return what this runs on, and how busy it is."""
    model = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = (line.partition(":") for line in info.read_text(encoding="utf-8").splitlines())
        model = next((value.strip() for name, _, value in lines if name.strip() == "model name"), model)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30 if hasattr(os, "sysconf") else 0
    load = f"load average {os.getloadavg()[0]:.0f}" if hasattr(os, "getloadavg") else "load not known"
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return Machine(model, os.cpu_count() or 1, round(memory), platform.python_version(), packages, load)


def regressions(ledger: Ledger, machine: Machine, figures: list[Figure]) -> Iterator[str]:
    """Yield a sentence for each figure that is worse than in the run before; call before ``Ledger.add``.

    Where a peer ran beside, both runs are taken relative to it: a machine that is busy slows the peer as well.
    """
    for figure in figures:
        before = ledger.last(figure.benchmark, figure.what, machine.key)
        if before is None or before.unit != figure.unit:
            continue
        now, then = figure.value / (figure.peer or 1.0), before.value / (before.peer or 1.0)
        if (figure.peer is None) != (before.peer is None) or min(now, then) <= 0:
            continue
        ratio = then / now if figure.more_is_better else now / then
        if ratio > WORSE:
            beside = " beside its peer" if figure.peer is not None else ""
            figures_of = f"{before.value:.4g} on {before.date}, now {figure.value:.4g} {figure.unit}"
            yield f"{figure.what}: {ratio:.2f} times worse{beside} ({figures_of})"


def write_page(ledger: Ledger, path: Path = PAGE) -> None:
    """Write the newest figure of everything as a page."""
    path.write_text("\n".join(page_lines(ledger)) + "\n", encoding="utf-8")


def page_lines(ledger: Ledger) -> Iterator[str]:
    """Yield the lines of the page."""
    yield "# Benchmarks\n"
    yield (
        "Written by `make bench`; all runs are in `benchmarks/history.csv`. A peer is what one would use instead, measured in\n"
        "the same run on the same machine: a parser that handles frame by frame, the maker's C++ library for MIP (mscl, where\n"
        "`pymscl` is installed), cantools, python-can, scipy, plain NumPy. imu_tk, a C++ program, is not run here. Under\n"
        "*gyroscope* its model is fitted to its own recording, and the results are compared.\n"
        "*Load* is the load of the machine by other programs. Where it exceeds the number of cores, times are too long; use\n"
        "the ratio to the peer only.\n"
    )
    if ledger.packages:
        yield f"Versions: {ledger.packages}.\n"
    for benchmark in sorted({entry.benchmark for entry in ledger.entries}):
        rows = {entry.what: entry for entry in ledger.entries if entry.benchmark == benchmark}
        newest = max(rows.values(), key=lambda entry: entry.date)
        yield f"## {benchmark}\n"
        yield "| figure | value | unit | peer | ratio | date, load |\n|---|---|---|---|---|---|"
        for entry in (entry for entry in rows.values() if entry.machine == newest.machine):
            beside = " | " if not entry.peer else f"{entry.peer:.4g} | {entry.value / entry.peer:.2f}"
            load = entry.load.removeprefix("load average ")
            yield f"| {entry.what} | {entry.value:.4g} | {entry.unit} | {beside} | {entry.date}, {load} |"
        yield f"\n{newest.machine}\n"
    for file in sorted(PRINTED.glob("*.txt")) if PRINTED.is_dir() else ():
        yield f"## {file.stem}\n\n```text\n{file.read_text(encoding='utf-8').rstrip()}\n```\n"
