"""The targets there are, and the one call that exports to any of them. Listing them imports no exporter and no NumPy."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import tomli

from imufield.dataclass import fields
from imufield.deliver.exports.target import Exported, ExportOptions, Target
from imufield.errors import UsageError
from imufield.files import refuse_overwriting, typed_write_errors, write_keeping
from imufield.sentences import Sentences

if TYPE_CHECKING:  # the parameter file needs NumPy and SciPy; a list of targets does not
    from imufield.deliver.parameters.file import Parameters

sentence = Sentences(__package__)

# IDs of sensors are 32-bit integers, 0 for none; of random walks in SI beyond these no inertial sensor is known.
_LIMITS = {
    "accelerometer_id": (1, 2**31 - 1),
    "gyroscope_id": (1, 2**31 - 1),
    "accelerometer_random_walk": (1e-12, 1.0),
    "gyroscope_random_walk": (1e-12, 1.0),
}

TARGETS: Mapping[str, Target] = {
    name: Target(name=name, **facts)
    for name, facts in tomli.loads(Path(__file__).with_name("targets.toml").read_text(encoding="utf-8")).items()
}


def target(name: str) -> Target:
    """Return the target called ``name``.

    Raises
    ------
    UsageError
        If there is no such target.
    """
    if name not in TARGETS:
        raise UsageError(sentence("registry.target", name=name, known=list(TARGETS)))
    return TARGETS[name]


def export_parameters(parameters: Parameters, target_name: str, options: ExportOptions | None = None) -> Exported:
    """Return a parameter file in the form of another program.

    Parameters
    ----------
    parameters : Parameters
        From ``imufield.load(path)``.
    target_name : str
        A key of ``TARGETS``.
    options : ExportOptions, optional

    Raises
    ------
    ParameterFileError
        If the target cannot express these parameters: a reversed axis, raw counts in an SI program, a number out of its
        range, a number that is not finite.
    UsageError
        If there is no such target, or an option is wrong for it.
    """
    chosen = target(target_name)
    from imufield.deliver.exports.job import run

    module = importlib.import_module(f"imufield.deliver.exports.{chosen.module}")
    return run(module.export, parameters, chosen, options or ExportOptions())


def export_options(settings: Mapping[str, str], target_name: str) -> ExportOptions:
    """Return options of a target from text, as in ``--set instance=1``.

    Raises
    ------
    UsageError
        If there is no such target, it has no such option, or a value does not fit.
    """
    names = target(target_name).option_names
    types = {item.name: str(item.type) for item in fields(ExportOptions)}
    values: dict[str, object] = {}
    for name, text in settings.items():
        if name not in names:
            raise UsageError(sentence("registry.option", target=target_name, name=name, known=names))
        values[name] = _value(name, types[name], text)
    return ExportOptions(**values)  # type: ignore[arg-type]  # each value was made by its field's type


def _value(name: str, kind: str, text: str) -> object:
    choices = {"gauge": ("lower", "upper", "symmetric"), "model": ("kalibr", "rpng")}.get(name)
    if choices is not None:
        if text in choices:
            return text
        raise UsageError(sentence("registry.choice", name=name, value=text, choices=choices))
    if not ("int" in kind or "float" in kind):
        return text
    try:
        # Base 0: device IDs are written in hexadecimal as well.
        value = int(text, 0) if "int" in kind else float(text)
    except ValueError as error:
        raise UsageError(sentence("registry.whole" if "int" in kind else "registry.number", name=name, value=text)) from error
    if name in _LIMITS:
        low, high = _LIMITS[name]
        # Not by a comparison that nan passes.
        if not low <= value <= high:
            raise UsageError(sentence("registry.limits", name=name, value=text, low=low, high=high))
    return value


class Written(NamedTuple):
    """One file on disk."""

    path: Path
    kept: Path | None
    """Where the other file that stood there before is kept."""


def write_exported(exported: Exported, output: str | Path | None = None, *, inputs: Sequence[Path] = ()) -> list[Written]:
    """Write the files, each atomically: into the folder ``output``, or one file under that name; never over ``inputs``.

    Returns
    -------
    list of Written
        In the order of ``exported.files``.

    Raises
    ------
    UsageError
        If several files would go under one file name, or one over an input or a recording.
    ParameterFileError
        If a file cannot be written; what stood under its name before is untouched.
    """
    folder = Path() if output is None else Path(output)
    if output is None or folder.is_dir():
        paths = [folder / name for name in exported.files]
    elif len(exported.files) == 1:
        paths = [folder]
    else:
        names = list(exported.files)
        raise UsageError(sentence("registry.folder", count=len(names), files=names, output=output))
    # All names before the first write: half an export is worse than none.
    for path in paths:
        refuse_overwriting(path, inputs)
    written = []
    for path, content in zip(paths, exported.files.values(), strict=True):
        with typed_write_errors(path):
            written.append(Written(path, write_keeping(path, content)))
    return written
