"""Files that a command writes beside the parameter file: pages, tables, plots."""

from __future__ import annotations

from pathlib import Path

from imufield.errors import ParameterFileError, Reason
from imufield.files import write_atomically


def write_output(path: Path, data: bytes) -> None:
    """Write a file in one step.

    Raises
    ------
    ParameterFileError
        If it cannot be written; what stood there is intact.
    """
    try:
        write_atomically(path, data)
    except OSError as error:
        raise ParameterFileError(
            f"{path} cannot be written ({error.strerror}); choose another place, or free some space",
            Reason.NO_PERMISSION,
            path=str(path),
        ) from error
