"""YAML: the same document as ``json``."""

from __future__ import annotations

from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.plain_json import document
from imufield.deliver.exports.text import comment, text_file, yaml_lines
from imufield.deliver.exports.whole_model import gauge_note


def export(job: Job) -> Draft:
    """Return the document."""
    content = text_file([*comment(job.heading()), *yaml_lines(document(job))])
    return Draft(files={"imufield_correction.yaml": content}, notes=gauge_note(job))
