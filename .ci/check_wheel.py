"""Fail unless the wheel holds exactly the tracked files of imufield/, drivers/ and protocols/."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

packed = {name for name in ZipFile(Path(sys.argv[1])).namelist() if ".dist-info/" not in name}
listing = subprocess.run(["git", "ls-files", "imufield", "drivers", "protocols"], check=True, capture_output=True, text=True)
# drivers/ and protocols/ are packages of imufield (package-dir in pyproject.toml).
wanted = {path if path.startswith("imufield/") else f"imufield/{path}" for path in listing.stdout.split()}
if packed != wanted:
    sys.exit(f"not in the wheel: {sorted(wanted - packed)}; not in git: {sorted(packed - wanted)}")
print(f"the wheel holds the {len(packed)} tracked files")
