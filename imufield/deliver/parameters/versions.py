"""Older versions of the parameter file, each brought to the next by a function of its own.

A file is checked against the hash of what was written first, then converted step by step in memory, then checked against the
schema like any other; the file itself stays as it is. A version without a converter is refused, and so is a key that its
version did not have. Version 1 is version 2 without temperature and is still written: it is not converted. Whoever ends a
version adds the step to the next to ``CONVERTERS``, and a file of it to the tests.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

from imufield.deliver.parameters.document import VERSION_WITHOUT_TEMPERATURE
from imufield.deliver.parameters.schema import Document
from imufield.deliver.parameters.write import EDITED, content_sha256
from imufield.errors import ParameterFileError, Reason
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_ZEROS = [0.0] * 3
_UNKNOWN = [math.nan] * 3
# What version 0, a draft with linear models only, could not say.
_NEW_IN_1: Document = {
    "accelerometer": {
        "raw_zero": _ZEROS,
        "quadratic": _ZEROS,
        "quadratic_axes": "sensing",
        "quadratic_fitted": False,
        "uncertainty": {"quadratic": _UNKNOWN},
        "intrinsic": {"quadratic": _ZEROS, "quadratic_sigma": _UNKNOWN},
    },
    "gyroscope": {"g_sensitivity": [_ZEROS] * 3, "uncertainty": {"g_sensitivity": [_UNKNOWN] * 3}},
}


def _from_0(document: Document) -> Document:
    """Version 0 knew no mid-scale, no quadratic term and no g-sensitivity: they are zero and were not estimated."""
    _add(document, _NEW_IN_1, "")
    return document


def _add(table: Document, keys: Document, above: str) -> None:
    for key, value in keys.items():
        if isinstance(value, dict):
            # What is missing or no table is for the schema to say.
            if isinstance(table.get(key), dict):
                _add(table[key], value, f"{above}{key}.")
        elif key in table:
            raise ParameterFileError(sentence("versions.unknown", key=above + key), Reason.UNKNOWN_KEY)
        else:
            table[key] = copy.deepcopy(value)


CONVERTERS: dict[int, Callable[[Document], Document]] = {0: _from_0}
"""From this version to the next, up to the one that is still written."""


def to_current(document: Document, version: int) -> Document:
    """Return a document of an older version as one that is still written; the one given is left alone.

    Raises
    ------
    ParameterFileError
        If it holds what its version did not have.
    """
    # What the caller holds stays what the file said.
    converted = copy.deepcopy(document)
    for step in range(version, VERSION_WITHOUT_TEMPERATURE):
        converted = {**CONVERTERS[step](converted), "version": step + 1}
    if converted["integrity"]["sha256"] != EDITED:
        converted["integrity"] = {"sha256": content_sha256(converted)}
    return converted
