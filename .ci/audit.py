"""Are the packages that imufield runs with those that were tested? Works without a vulnerability database.

``python .ci/audit.py``: every installed file of every dependency against the SHA-256 that its package declares, and every
package resolved anew against ``.ci/requirements.lock``: a version that is known there must have the hash noted there.
``python .ci/audit.py --write`` resolves and writes the list. Run in the environment that ``make`` made.
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
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
LOCK = PROJECT / ".ci" / "requirements.lock"
EXTRAS = "nav,report,noise,study,formats,dev"


def normal(name: str) -> str:
    """Return a name as all of its spellings."""
    return re.sub(r"[-_.]+", "-", name).lower()


def resolved() -> dict[str, tuple[str, str]]:
    """Return version and SHA-256 by name, of everything a full installation takes."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--report", "-"]
    answer = subprocess.run([*command, f".[{EXTRAS}]"], cwd=PROJECT, check=True, capture_output=True, text=True)
    found = {}
    for one in json.loads(answer.stdout)["install"]:
        sha256 = one["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256")
        if sha256:
            found[normal(one["metadata"]["name"])] = (one["metadata"]["version"], sha256)
    return found


def locked() -> dict[str, tuple[str, str]]:
    """Return version and SHA-256 by name, as noted."""
    lines = re.findall(r"^([\w.-]+)==(\S+) --hash=sha256:([0-9a-f]{64})$", LOCK.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: (version, sha256) for name, version, sha256 in lines}


def write() -> None:
    """Write the list anew."""
    head = f"# Python {platform.python_version()}, {platform.system()} {platform.machine()}; written by .ci/audit.py --write\n"
    lines = (f"{name}=={version} --hash=sha256:{sha256}\n" for name, (version, sha256) in sorted(resolved().items()))
    LOCK.write_text(head + "".join(lines), encoding="utf-8")


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
    for name, (version, sha256) in resolved().items():
        if name not in known:
            faults.append(f"{name} is not in {LOCK.name}: read what it is, then make lock")
        elif known[name][0] == version and known[name][1] != sha256:
            faults.append(f"{name} {version} has another hash than noted: do not install it")
    for name in known:
        try:
            spoilt = spoilt_files(distribution(name))
        except PackageNotFoundError:
            continue
        faults += [f"{path} is not the file that {name} was packed with" for path in spoilt]
    return faults


if __name__ == "__main__":
    if "--write" in sys.argv:
        write()
    faults = audit()
    print("\n".join(faults) or f"{len(locked())} packages are as noted")
    sys.exit(bool(faults))
