"""The errors a user can cause. One sentence each: what, where, the limit, the measured value, the remedy.

::

    ImufieldError (exit code 1 is never used by these: it marks a defect of ours)
    +-- UsageError            2  an option, a file name or a value typed by the user
    +-- LinkError             3  port, bus, permission, silence, disconnection
    +-- RecordingError        4  a recording or session that cannot be read or written
    +-- ProtocolError         4  wire data or a protocol file that cannot be understood
    |                           (SettingError and UnknownNameError are both: a setting or a name that was typed, 2)
    +-- ParameterFileError    5  a parameter file that is damaged, newer or foreign
    +-- CalibrationError      6  a calibration that is impossible or refused
    +-- VerificationError     7  ``verify`` says FAIL

Bad input raises one of these and nothing else; any other exception is a defect and keeps its traceback. Which one a failed
write is, and what it means, is in ``files.write_error``; which one a package that is not installed, in ``load_package``.
"""

from __future__ import annotations

import importlib
from enum import Enum
from types import ModuleType
from typing import Any, ClassVar

from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

EXIT_INTERRUPTED = 130
"""What typer leaves with after Ctrl-C; SIGTERM and SIGHUP take the same way."""


class Reason(Enum):
    """Why an error was raised, for programs; people read the message."""

    USAGE = "usage"
    PORT_NOT_FOUND = "port_not_found"
    PORT_BUSY = "port_busy"
    NO_PERMISSION = "no_permission"
    SILENCE = "silence"
    NO_FRAMES = "no_frames"
    DISCONNECTED = "disconnected"
    REFUSED = "refused"
    UNKNOWN_DRIVER = "unknown_driver"
    DRIVER_FAILED = "driver_failed"
    BAD_PROTOCOL = "bad_protocol"
    BAD_DATA = "bad_data"
    DISK_FULL = "disk_full"
    NOT_A_RECORDING = "not_a_recording"
    DAMAGED = "damaged"
    NEWER = "newer"
    UNFINISHED = "unfinished"
    LOCKED = "locked"
    UNKNOWN_KEY = "unknown_key"
    FOREIGN = "foreign"
    TOO_FEW = "too_few"
    UNOBSERVABLE = "unobservable"
    HANDEDNESS = "handedness"
    SATURATED = "saturated"
    GRAVITY = "gravity"
    NOT_FINITE = "not_finite"
    NOT_CONVERGED = "not_converged"
    BOUNDS = "bounds"
    UNITS = "units"
    MISSING_PACKAGE = "missing_package"
    FAILED_REQUIREMENT = "failed_requirement"


class ImufieldError(Exception):
    """Base of every error a user can cause.

    Parameters
    ----------
    message : str
        One sentence: what, where, limit, measured value, remedy. One of ``sentences.toml`` brings its values along.
    reason : Reason
        The same for programs.
    **values : object
        Further values, kept as ``error.values`` with those of the sentence.
    """

    exit_code: ClassVar[int] = 2
    default_reason: ClassVar[Reason] = Reason.USAGE

    def __init__(self, message: str, reason: Reason | None = None, **values: Any) -> None:
        super().__init__(message)
        self.message = message
        self.reason = reason or self.default_reason
        self.values = {**message.values, **values} if isinstance(message, Sentence) else values


class UsageError(ImufieldError, ValueError):
    """An option, a file name or a value typed by the user makes no sense."""

    # Those of the base, stated again: they go before those of the other kind that a subclass is as well.
    exit_code = 2
    default_reason = Reason.USAGE


class LinkError(ImufieldError, ConnectionError):
    """The port, bus or network link does not do what was asked."""

    exit_code = 3
    default_reason = Reason.DISCONNECTED


class LinkTimeoutError(LinkError, TimeoutError):
    """Nothing, or nothing usable, arrived in time."""

    default_reason = Reason.SILENCE


class RecordingError(ImufieldError, ValueError):
    """A recording or session cannot be read or written."""

    exit_code = 4
    default_reason = Reason.DAMAGED


class ProtocolError(ImufieldError, ValueError):
    """Wire data, a protocol file or a driver cannot be understood."""

    exit_code = 4
    default_reason = Reason.BAD_PROTOCOL


class SettingError(UsageError, ProtocolError):
    """A setting of a protocol that was given does not exist, or cannot have this value."""


class UnknownNameError(UsageError, ProtocolError):
    """There is no driver or protocol of the name that was typed."""


class ParameterFileError(ImufieldError, ValueError):
    """A parameter file is damaged, newer, foreign or inconsistent."""

    exit_code = 5
    default_reason = Reason.DAMAGED


class CalibrationError(ImufieldError, ValueError):
    """A calibration is impossible from these data, or refused."""

    exit_code = 6
    default_reason = Reason.TOO_FEW


class VerificationError(ImufieldError):
    """``verify`` finds a requirement not met."""

    exit_code = 7
    default_reason = Reason.FAILED_REQUIREMENT


def missing_package(what: str, package: str, extra: str, cause: object = "") -> UsageError:
    """Return the error that a package of an extra, or of imufield itself where that is empty, is not installed.

    ``cause`` is what Python says where it may be installed, and made for another Python, NumPy or system.
    """
    key = "errors.broken_package" if cause else "errors.missing_package"
    wanted = f"'.[{extra}]'" if extra else "."
    return UsageError(sentence(key, what=what, package=package, wanted=wanted, cause=cause), Reason.MISSING_PACKAGE)


def load_package(module: str, what: str, extra: str, package: str = "") -> ModuleType:
    """Return a module of an extra's package, by default of the module's name; ``what`` needs it.

    Raises
    ------
    UsageError
        If the package is not installed, or cannot be imported.
    """
    package = package or module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:  # OSError: it is there, and a library that it loads is not.
        own = module.partition(".")[0]
        is_absent = isinstance(error, ModuleNotFoundError) and (error.name or own).partition(".")[0] == own
        raise missing_package(what, package, extra, "" if is_absent else error) from error
