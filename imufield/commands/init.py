"""``imufield init``: the defaults of a folder, asked for and written."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import tomli_w

from imufield.acquire.link.ports import serial_ports
from imufield.acquire.registry import load_driver
from imufield.commands.options.acquire_commands import InitOptions
from imufield.commands.options.configuration import FILE_NAME
from imufield.commands.terminal.output import say, tell_written
from imufield.commands.terminal.questions import ask, ask_until, confirm
from imufield.commands.terminal.site import NOT_KNOWN, ask_site, read_answer
from imufield.dataclass import replace
from imufield.errors import UsageError
from imufield.files import typed_write_errors, write_keeping
from imufield.limits import TARGET_RANGE
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def run_init(options: InitOptions) -> None:
    """Write ``imufield.toml`` in the working folder from options, and at a terminal from answers.

    Raises
    ------
    UsageError
        There is no terminal and no option, a value makes no sense, or the file is there and is to stay.
    ParameterFileError
        The file cannot be written.
    """
    path = Path(FILE_NAME)
    options.site.place().check()
    if options.driver is not None:
        load_driver(options.driver)
    values = _values(options)
    is_asked = sys.stdin.isatty() and sys.stdout.isatty()
    if not (values or is_asked):
        raise UsageError(sentence("init.no_terminal"))
    if os.path.lexists(path) and not (is_asked and confirm(sentence("init.replace", path=path))):
        raise UsageError(sentence("init.exists", path=path))
    if is_asked:
        values = _values(_asked(options))
    else:
        options.site.gravity()  # Refuses a typed height alone, as the questions do.
    if not values:
        raise UsageError(sentence("init.nothing"))
    text = f"# Defaults of imufield in this folder; all keys: docs/file-formats.md\n{tomli_w.dumps(values)}"
    with typed_write_errors(path):
        kept = write_keeping(path, text.encode())
    tell_written(path, kept)
    say(sentence("init.next"))


def _values(options: InitOptions) -> dict[str, object]:
    """Return the content of the file."""
    site = options.site.place()
    # As it is typed: with its standard deviation.
    sigma = "" if site.gravity_sigma_m_s2 is None else f"+-{site.gravity_sigma_m_s2:g}"
    values = {
        "port": options.port,
        "driver": options.driver,
        "gravity": None if site.gravity_m_s2 is None else f"{float(site.gravity_m_s2)!r}{sigma}",
        "latitude": site.latitude_deg,
        "height": site.height_m,
        "target_bias_ug": options.target_bias_ug,
        "target_scale_ppm": options.target_scale_ppm,
    }
    return {name: value for name, value in values.items() if value is not None}


def _asked(options: InitOptions) -> InitOptions:
    """Return the options with what was typed to the questions, which are asked where an option is not given."""
    site, port, target = ask_site(options.site, options.root), options.port, _number(*TARGET_RANGE)
    driver = options.driver or ask_until(sentence("init.driver"), lambda name: load_driver(name).name if name else None)
    # An instrument on a bus has no port.
    if port is None and (driver is None or load_driver(driver).wire == "serial"):
        port = _ask_port()
    bias_ug = options.target_bias_ug or ask_until(sentence("init.target_bias_ug"), target)
    scale_ppm = options.target_scale_ppm or ask_until(sentence("init.target_scale_ppm"), target)
    return replace(options, site=site, driver=driver, port=port, target_bias_ug=bias_ug, target_scale_ppm=scale_ppm)


def _ask_port() -> str | None:
    found = [port.device for port in serial_ports()]
    if len(found) > 1:
        say(sentence("init.ports", ports=found))
    only = found[0] if len(found) == 1 else None
    answer = ask(sentence("init.no_port") if only is None else sentence("init.port", port=only))
    return {"": only, NOT_KNOWN: None}.get(answer, answer)


def _number(low: float, high: float) -> Callable[[str], float | None]:
    def read(answer: str) -> float | None:
        value = read_answer(answer) if answer else None
        # Written so that NaN is outside.
        if value is not None and not low <= value <= high:
            raise UsageError(sentence("init.outside", value=value, low=low, high=high))
        return value

    return read
