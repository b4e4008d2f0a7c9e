"""Are the packages in ``.venv`` those that were tested? Works without a vulnerability database, and without a network.

``python .ci/audit.py``: every installed package against ``.ci/requirements.lock`` (name and version), and every file of it
against the SHA-256 that the package declares. ``.ci/run`` installs by the hashes of the lock.
``python .ci/audit.py --write`` resolves all dependencies anew, and writes the lock and ``docs/licences.md``.
``python .ci/audit.py --fits`` ends with 0 where the lock was written for this Python and system.
``python .ci/audit.py --needed`` prints the lines of the lock that imufield needs without its extras.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import platform
import re
import subprocess
import sys
import tomllib
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
LOCK = PROJECT / ".ci" / "requirements.lock"
LICENCES = PROJECT / "docs" / "licences.md"
EXTRAS = "nav,report,pdf,noise,study,formats,dev"
# The program itself, and what every virtual environment of Python 3.11 is made with.
NOT_LOCKED = ("imufield", "pip")
LONGEST_LICENCE = 160  # Characters: three names.


def normal(name: str) -> str:
    """Return a name as all of its spellings."""
    return re.sub(r"[-_.]+", "-", name).lower()


def made_for() -> str:
    """Return what a lock of this Python and system says that it is for."""
    return f"Python {'.'.join(platform.python_version_tuple()[:2])}, {platform.system()} {platform.machine()}"


def resolved() -> dict[str, tuple[str, str]]:
    """Return version and SHA-256 by name, of everything a full installation takes, the build tools included."""
    build = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--report", "-"]
    answer = subprocess.run([*command, f".[{EXTRAS}]", *build], cwd=PROJECT, check=True, capture_output=True, text=True)
    found = {}
    for package in json.loads(answer.stdout)["install"]:
        sha256 = package["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256")
        if sha256:
            found[normal(package["metadata"]["name"])] = (package["metadata"]["version"], sha256)
    return found


def locked() -> dict[str, tuple[str, str]]:
    """Return version and SHA-256 by name, as noted."""
    lines = re.findall(r"^([\w.-]+)==(\S+) --hash=sha256:([0-9a-f]{64})$", LOCK.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: (version, sha256) for name, version, sha256 in lines}


def write() -> None:
    """Write the lock anew, and the list of licences from the packages that are installed."""
    lines = (f"{name}=={version} --hash=sha256:{sha256}\n" for name, (version, sha256) in sorted(resolved().items()))
    LOCK.write_text(f"# {made_for()}; written by .ci/audit.py --write\n" + "".join(lines), encoding="utf-8")
    LICENCES.write_text(licences(), encoding="utf-8")


def licences() -> str:
    """Return the page of licences."""
    needed = needed_without_extras()
    rows = [f"| {name} | {'always' if name in needed else ''} | {licence(distribution(name))} |\n" for name in sorted(locked())]
    return (
        "# Licences of the dependencies\n\n"
        "Written by `make lock` from what the packages declare. *always*: `pip install .` takes it; the others come\n"
        "with an extra or are tools of the developers.\n\n| package | | licence |\n|---|---|---|\n" + "".join(rows)
    )


def licence(package: Distribution) -> str:
    """Return the licence that a package declares: expression, classifier, or the first line of what it says."""
    declared = package.metadata.json
    classifiers = [row.rpartition(" :: ")[2] for row in declared.get("classifier", []) if row.startswith("License :: ")]
    named = declared.get("license_expression") or ", ".join(row for row in classifiers if row != "OSI Approved")
    said = str(named or declared.get("license") or "not declared").strip()
    # Some packages put the whole text where its name belongs.
    said = "MIT" if "Permission is hereby granted, free of charge" in said else said.splitlines()[0]
    return said[:LONGEST_LICENCE].replace("|", "/")


def needed_without_extras() -> set[str]:
    """Return the names of what imufield needs on this system, whatever extras are there."""
    from packaging.requirements import Requirement  # Not there before the lock is installed.

    found: set[str] = set()
    asked: set[tuple[str, str]] = set()
    waiting = {("imufield", "")}
    while waiting - asked:
        name, extra = (waiting - asked).pop()
        asked.add((name, extra))
        for line in distribution(name).requires or ():
            wanted = Requirement(line)
            if wanted.marker is None or wanted.marker.evaluate({"extra": extra}):
                found.add(normal(wanted.name))
                waiting |= {(normal(wanted.name), extra) for extra in ("", *wanted.extras)}
    return found


def spoilt_files(package: Distribution) -> list[str]:
    """Return the installed files that are not what the package says."""
    record = package.read_text("RECORD") or ""
    spoilt = []
    for name, noted, _ in csv.reader(record.splitlines()):
        algorithm, _, digest = noted.partition("=")
        path = Path(str(package.locate_file(name)))
        # Outside of the package folder two packages may write the same name, and programs start with a line of this machine.
        if algorithm == "sha256" and not name.startswith("..") and path.suffix != ".pyc":
            there = hashlib.sha256(path.read_bytes()).digest() if path.is_file() else b""
            if base64.urlsafe_b64encode(there).decode().rstrip("=") != digest:
                spoilt.append(str(path))
    return spoilt


def audit() -> list[str]:
    """Return a sentence for everything that is not as it should be."""
    faults, known = [], locked()
    for package in distributions():
        name, version = normal(package.metadata["Name"]), package.version
        if name in NOT_LOCKED:
            continue
        if name not in known:
            faults.append(f"{name} is not in {LOCK.name}: read what it is, then make lock")
        elif version != known[name][0]:
            faults.append(f"{name} {version} is installed, {known[name][0]} was tested: make lock notes the new one")
        faults += [f"{path} is not the file that {name} was packed with" for path in spoilt_files(package)]
    if LICENCES.read_text(encoding="utf-8") != licences():
        faults.append(f"docs/{LICENCES.name} is not what the packages declare: make lock writes it")
    return faults


if __name__ == "__main__":
    if "--fits" in sys.argv:
        sys.exit(not LOCK.read_text(encoding="utf-8").startswith(f"# {made_for()};"))
    if "--needed" in sys.argv:
        print("\n".join(f"{name}=={locked()[name][0]} --hash=sha256:{locked()[name][1]}" for name in needed_without_extras()))
        sys.exit(0)
    if "--write" in sys.argv:
        write()
    faults = audit()
    print("\n".join(faults) or f"{len(locked())} packages are as noted")
    sys.exit(bool(faults))
