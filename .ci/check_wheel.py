"""Fail unless the wheel holds exactly the tracked files of imufield/, drivers/ and protocols/, and the man page."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

packed = {name for name in ZipFile(Path(sys.argv[1])).namelist() if ".dist-info/" not in name}
# Behind the name and version of the distribution.
packed = {name.partition(".data/data/")[2] or name for name in packed}
listing = subprocess.run(["git", "ls-files", "imufield", "drivers", "protocols"], check=True, capture_output=True, text=True)
# drivers/ and protocols/ are packages of imufield (package-dir in pyproject.toml).
wanted = {path if path.startswith("imufield/") else f"imufield/{path}" for path in listing.stdout.split()}
wanted |= {"share/man/man1/imufield.1"}
if packed != wanted:
    sys.exit(f"not in the wheel: {sorted(wanted - packed)}; not in git: {sorted(packed - wanted)}")
print(f"the wheel holds the {len(packed)} tracked files")
