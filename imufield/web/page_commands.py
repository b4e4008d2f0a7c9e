"""What a page of the workbench can ask for: a command of imufield each, and what may stand behind its options.

The buttons of the guide are marks and no commands: ``guide_page``.

A value is one word of the command line, ``--option=value``, and never begins one; there is no shell. Names lead into the folder
of sessions and nowhere else.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path

from imufield.dataclass import dataclass
from imufield.errors import UsageError
from imufield.files import real_path
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)

UPLOADS = "uploads"
"""Folder below that of the sessions for files that were dropped on the page."""
VIRTUAL = "virtual-stim300"
"""Name of the port of a virtual instrument, there: a session that was recorded from one finds it again."""
LONGEST_TEXT = 200  # Characters: a name of an operator or a position, the columns of a table.
LARGEST_NUMBER = 1e9  # Beyond every option.
MOST_VALUES = 100  # Of one option: positions to leave out, settings, files.

_NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,99}", re.ASCII)
_WORD = re.compile(r"[a-z][a-z0-9_-]{0,63}")
_GRAVITY = re.compile(r"\d{1,2}(\.\d{1,12})?(\+-\d{1,2}(\.\d{1,12})?)?")
# Opening a device of another kind may do something to the machine.
_DEVICE = re.compile(r"/dev/(tty|cu\.|pts/|rfcomm)[\w./-]{0,100}", re.ASCII)
# Other addresses of pyserial write files or load code: those a person types at a terminal.
_PORT = re.compile(r"(socket|rfc2217)://[\w.:\[\]-]{1,100}|COM\d{1,3}", re.ASCII)
_BUS = re.compile(r"(?P<interface>[a-z0-9_]{1,32}):(?P<channel>[\w./:-]{1,100})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Sessions:
    """The folder of sessions, as its path is shown.

    Attributes
    ----------
    root : Path
    """

    root: Path

    def existing(self, name: object) -> Path:
        """Return the path of a session; raises ``UsageError`` for what is no folder of the root."""
        path = self.root / _text(name)
        is_inside = real_path(path).parent == real_path(self.root) and path.name == name
        if not (is_inside and os.path.isdir(path)):  # noqa: PTH112  (a Path raises ``OSError`` for a name that is too long)
            raise UsageError(sentence("page_commands.no_session", name=name, root=self.root))
        return path

    def new(self, name: object) -> Path:
        """Return the path of a session to be; raises ``UsageError`` for a name that is not plain or is taken."""
        path = self.root / _matching(_NAME)(name)
        if name == UPLOADS or path.exists():
            raise UsageError(sentence("page_commands.taken", name=name, root=self.root))
        return path

    def holds(self, path: Path) -> bool:
        """Whether a path leads to something below the root, links followed."""
        return real_path(path).is_relative_to(real_path(self.root))

    def file(self, path: object) -> Path:
        """Return the path of a file below the root; raises ``UsageError`` for any other."""
        found = self.root / _text(path)
        if not (self.holds(found) and os.path.isfile(found)):  # noqa: PTH113  (as above)
            raise UsageError(sentence("page_commands.no_file", name=path, root=self.root))
        return found


def _text(value: object) -> str:
    if not (isinstance(value, str) and 0 < len(value) <= LONGEST_TEXT and printable(value) == value):
        raise UsageError(sentence("page_commands.no_text", value=str(value)[:LONGEST_TEXT], limit=LONGEST_TEXT))
    return value


def _matching(pattern: re.Pattern[str]) -> Callable[[object], str]:
    def check(value: object) -> str:
        if not pattern.fullmatch(_text(value)):
            raise UsageError(sentence("page_commands.no_name", value=value))
        return str(value)

    return check


def _number(value: object) -> str:
    # Written so that NaN is none.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_NUMBER:
        raise UsageError(sentence("page_commands.no_number", value=str(value)[:LONGEST_TEXT]))
    return repr(value)


def _port(value: object) -> str:
    path = _text(value)
    if not (_PORT.fullmatch(path) or _DEVICE.fullmatch(os.path.realpath(path))):
        raise UsageError(sentence("page_commands.no_port", value=path))
    return path


def _bus(value: object) -> str:
    bus = _BUS.fullmatch(_text(value))
    # An adapter is a port, or has a name without a path.
    if bus is None or ("/" in bus["channel"] and not _DEVICE.fullmatch(os.path.realpath(bus["channel"]))):
        raise UsageError(sentence("page_commands.no_name", value=value))
    return bus[0]


# From a value of the page to words of the command line.
Field = Callable[[object, Sessions], list[str]]


def _option(name: str, check: Callable[[object], str]) -> Field:
    return lambda value, _: [f"{name}={check(value)}"]


def _each(name: str, check: Callable[[object], str]) -> Field:
    def words(value: object, _: Sessions) -> list[str]:
        return [f"{name}={check(entry)}" for entry in _few(value)]

    return words


def _few(value: object) -> list[object]:
    if not isinstance(value, list) or len(value) > MOST_VALUES:
        raise UsageError(sentence("page_commands.too_many", limit=MOST_VALUES))
    return value


def _flag(name: str) -> Field:
    return lambda value, _: [name] if _is_wanted(value) else []


def _is_wanted(value: object) -> bool:
    if not isinstance(value, bool):
        raise UsageError(sentence("page_commands.no_name", value=str(value)[:LONGEST_TEXT]))
    return value


def _setting(value: object) -> str:
    name, _, setting = _text(value).partition("=")
    return f"{_matching(_WORD)(name)}={_text(setting)}"


def _session(value: object, sessions: Sessions) -> list[str]:
    return [_argument(sessions.existing(value))]


def _parameters(value: object, sessions: Sessions) -> list[str]:
    return [_argument(sessions.file(f"{sessions.existing(value).name}/parameters.toml"))]


def _files(value: object, sessions: Sessions) -> list[str]:
    return [_argument(sessions.file(path)) for path in _few(value)]


def _argument(path: Path) -> str:
    """Return a path that is no option, whatever its name begins with."""
    return f"./{path}" if str(path).startswith("-") else str(path)


_SITE: Mapping[str, Field] = {
    "latitude": _option("--latitude", _number),
    "height": _option("--height", _number),
    "gravity": _option("--gravity", _matching(_GRAVITY)),
}
_PLACE: Mapping[str, Field] = {"port": _option("--port", _port), "bus": _option("--bus", _bus)}
_DRIVER = _option("--driver", _matching(_WORD))
_SETTINGS = _each("--set", _setting)
_CLOCK_SPEED = _option("--clock-speed", _number)
_GOAL: Mapping[str, Field] = {
    "positions": _option("--positions", _matching(_WORD)),
    "hold_s": _option("--hold-s", _number),
    "target_bias_ug": _option("--target-bias-ug", _number),
    "target_scale_ppm": _option("--target-scale-ppm", _number),
}


@dataclass(frozen=True, slots=True)
class Action:
    """A command, the options that are always given, and those that a page may give, by the names it has for them."""

    words: str
    fields: Mapping[str, Field]
    needs: tuple[str, ...] = ()
    """Without these it would be about the newest session, or a new one of another folder."""
    is_alone: bool = False
    """Whether one that runs at the same port is taken in place of a second one."""


ACTIONS: Mapping[str, Action] = {
    "devices": Action("devices --json", {"driver": lambda value, _: [_matching(_WORD)(value)]}),
    # A page that is loaded anew would find the port in use by the probe of the one before.
    "probe": Action("probe --json", _PLACE, is_alone=True),
    "emulate": Action(
        f"emulate stim300 --json --wait --rate-hz=500 --link={{root}}/{VIRTUAL}",
        {"speed": _option("--speed", _number)},
        is_alone=True,
    ),
    "plan": Action(
        "plan --json",
        {
            **_GOAL,
            **_SITE,
            "noise_ug": _option("--noise-ug", _number),
            "grade": _option("--grade", _matching(_WORD)),
        },
    ),
    "capture": Action(
        "capture --json --web",
        {
            **_PLACE,
            **_SITE,
            "driver": _DRIVER,
            "baud": _option("--baud", _number),
            "settings": _SETTINGS,
            **_GOAL,
            "cable": _option("--cable", _text),
            "clock_speed": _CLOCK_SPEED,
            "new": lambda value, sessions: [f"--session={sessions.new(value)}"],
        },
        needs=("new",),
    ),
    "resume": Action(
        "capture --json --web --resume",
        {
            **_PLACE,
            "session": lambda value, sessions: [f"--session={sessions.existing(value)}"],
            "retake": _each("--retake", _text),
            "driver": _DRIVER,
            "clock_speed": _CLOCK_SPEED,
        },
        needs=("session",),
    ),
    "solve": Action(
        "solve --json",
        {"session": _session, **_SITE, "without": _each("--without", _text)},
        needs=("session",),
    ),
    "report": Action(
        "report", {"session": _session, "operator": _option("--operator", _text), "pdf": _flag("--pdf")}, needs=("session",)
    ),
    "targets": Action("export --json", {}),
    "export": Action(
        "export --json",
        {
            "session": lambda value, sessions: [*_parameters(value, sessions), f"--output={sessions.existing(value)}"],
            "to": _option("--to", _matching(_WORD)),
            "settings": _SETTINGS,
        },
        needs=("session", "to"),
    ),
    "outline": Action("export-data --to=outline", {"session": _session}, needs=("session",)),
    "overview": Action("export-data --to=overview", {"session": _session}, needs=("session",)),
    "replay": Action("replay --web --json", {"session": _session, "speed": _option("--speed", _number)}, needs=("session",)),
    "sessions": Action("sessions --json {root}", {}),
    "history": Action(
        "history --json {root}",
        {
            "serial_number": _option("--serial", _text),
            "plot": lambda value, sessions: [f"--plot={sessions.root / 'history.svg'}"] if _is_wanted(value) else [],
        },
    ),
    "import": Action(
        "import --json",
        {
            "files": _files,
            "new": lambda value, sessions: [f"--output={sessions.new(value)}"],
            **_SITE,
            "driver": _DRIVER,
            "settings": _SETTINGS,
            "columns": _option("--columns", _text),
            "rate_hz": _option("--rate-hz", _number),
            "zero": _option("--zero", _text),
        },
        needs=("files", "new"),
    ),
}


def command_line(name: object, values: object, sessions: Sessions) -> list[str]:
    """Return the words of a command, behind "imufield".

    Parameters
    ----------
    name, values : object
        As a page sent them: the action, and a value for each of its fields that is given.
    sessions : Sessions

    Raises
    ------
    UsageError
        If there is no such action or field, a value is none for it, or one that is needed is missing.
    """
    action = ACTIONS.get(name) if isinstance(name, str) else None
    if action is None or not isinstance(values, dict) or not values.keys() <= action.fields.keys():
        raise UsageError(sentence("page_commands.unknown", name=str(name)[:LONGEST_TEXT]))
    missing = [field for field in action.needs if field not in values]
    if missing:
        raise UsageError(sentence("page_commands.missing", name=name, missing=missing))
    words = [word.format(root=_argument(sessions.root)) for word in action.words.split()]
    # In the order of the table, so that a person reads the same command for the same values.
    return words + [word for field, make in action.fields.items() if field in values for word in make(values[field], sessions)]
