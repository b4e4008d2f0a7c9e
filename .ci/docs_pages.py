"""Pages of the documentation that come from the program itself: commands, instruments, schemas, and files of the root.

A hook of mkdocs. What is generated is never stored, so it cannot be out of date.
"""

from __future__ import annotations

import inspect
import runpy
import subprocess
import sys
from collections.abc import Iterator
from importlib.resources import files as resources
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from typer.main import get_command

from imufield.acquire.registry import driver_names, load_driver
from imufield.cli.app import make_app

PROJECT = Path(__file__).resolve().parent.parent
SCHEMAS = {"parameters.schema.json": "imufield.deliver.parameters", "events.schema.json": "imufield.guide"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put pages that the navigation does not name under "More"; called by mkdocs."""
    named = (PROJECT / "mkdocs.yml").read_text(encoding="utf-8")
    left = [page.name for page in sorted((PROJECT / "docs").glob("*.md")) if f" {page.name}\n" not in named]
    targets = [f"exports/{page.name}" for page in sorted((PROJECT / "docs" / "exports").glob("*.md"))]
    config.nav = [*(config.nav or []), *([{"More": left}] if left else []), {"Export targets": targets}]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages; called by mkdocs."""
    pages = {
        "commands.md": "\n".join(commands()),
        "instruments.md": "\n".join(instruments()),
        "security.md": root_page("SECURITY.md"),
        "contributing.md": root_page("CONTRIBUTING.md"),
        "changes.md": changes(),
        "imufield.1": runpy.run_path(str(Path(__file__).with_name("man_page.py")))["man_page"](),
        **{name: (resources(package) / name).read_text(encoding="utf-8") for name, package in SCHEMAS.items()},
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Return a page whose links to the root's pages lead to those added here; called by mkdocs."""
    return markdown.replace("](../SECURITY.md", "](security.md")


def commands() -> Iterator[str]:
    """Yield the page of all commands, from what ``--help`` says."""
    yield "# Commands\n\n`imufield COMMAND -h` and [the man page](imufield.1) say the same. Exit codes: [errors](errors.md).\n"
    group: Any = get_command(make_app())
    for name, command in sorted(group.commands.items()):
        text = inspect.cleandoc(command.help or "")
        summary, *examples = text.split("Example:")
        yield f"## {name}\n\n{summary.strip()}\n"
        if examples:
            yield "\n".join(["```console", *(f"$ {' '.join(example.split())}" for example in examples), "```\n"])
        yield from options(command)


def options(command: Any) -> Iterator[str]:
    """Yield the table of a command's arguments and options."""
    yield "| argument or option | meaning | default |\n|---|---|---|"
    for one in command.params:
        if getattr(one, "hidden", False):
            continue
        spelled = (*one.opts, *one.secondary_opts) if one.param_type_name == "option" else (str(one.name).upper(),)
        names = ", ".join(f"`{name}`" for name in spelled)
        shown = "" if one.default in (None, False, ()) or callable(one.default) else f"`{one.default}`"
        variable = f" Variable `{one.envvar}`." if getattr(one, "envvar", None) else ""
        yield f"| {names} | {cell(getattr(one, 'help', '') or '')}{variable} | {shown} |"
    yield ""


def cell(text: str) -> str:
    """Return a text for a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def instruments() -> Iterator[str]:
    """Yield the page of all instruments, from the drivers and the protocols they name."""
    yield "# Instruments\n\nWhat this version knows. Settings are given by `--set name=value`."
    yield "A format of your own is [a short file](protocols.md).\n"
    for name in driver_names():
        driver = load_driver(name)
        yield f"## {driver.title}\n\n`--driver {name}`; {driver.status}.\n"
        others = ", ".join(str(baud) for baud in driver.bauds if baud != driver.default_baud)
        also = f" (also {others})" if others else ""
        interface = driver.wiring if driver.wire == "serial" else driver.wire
        yield f"* Wire: {interface}, {driver.default_baud} bit/s{also}\n* Manual: {driver.manual}\n"
        yield f"```text\n{inspect.getdoc(driver)}\n```\n"
        yield from settings_of(driver)


def settings_of(driver: Any) -> Iterator[str]:
    """Yield the table of a driver's settings."""
    protocol = driver.load_protocol()
    if not protocol.settings:
        return
    yield "| setting | value where nothing is said | allowed | meaning |\n|---|---|---|---|"
    for name, rule in protocol.rules.items():
        yield f"| `{name}` | `{protocol.settings[name].value}` | {cell(rule.allowed)} | {cell(rule.help)} |"
    yield ""


def root_page(name: str) -> str:
    """Return a page of the root with its links as seen from here."""
    return from_here((PROJECT / name).read_text(encoding="utf-8"))


def from_here(text: str) -> str:
    """Return a text of the root with its links as seen from the documentation's folder."""
    return (
        text.replace("](docs/", "](")
        .replace("](CONTRIBUTING.md", "](contributing.md")
        .replace("](SECURITY.md", "](security.md")
    )


def changes() -> str:
    """Return the change log with what is not released yet."""
    command = [sys.executable, "-m", "towncrier", "build", "--draft", "--version", "not released yet", "--date", ""]
    draft = subprocess.run(command, cwd=PROJECT, check=True, capture_output=True, text=True).stdout
    news = draft[draft.index("## ") :] if "## " in draft else ""
    text = (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8")
    return from_here(text.replace("<!-- released -->", news.replace(" ()", "")))
