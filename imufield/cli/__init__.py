"""The command line: arguments in, exit codes out. What each command does is in ``imufield.commands``.

Nothing heavy is imported here: each command imports its own room, so that a prompt comes back at once.
"""

from __future__ import annotations

import os
import sys

EXIT_INTERRUPTED = 130
"""What typer leaves with after Ctrl-C; SIGTERM and SIGHUP take the same way."""


def main() -> None:
    """Run the command line and leave with the exit code that docs/errors.md lists."""
    # The matrices are small: threads of the linear algebra would double the processor time and gain nothing.
    for library in ("OPENBLAS", "MKL", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    try:
        # Imported here, so that a Ctrl-C in the first tenth of a second is one like any other.
        from imufield.cli.run import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    sys.exit(code)
