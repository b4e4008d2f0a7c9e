"""pyins: ``x_out = transform x + bias`` (inertial_sensor.Parameters, error direction), as a Python module."""

from __future__ import annotations

from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, row, rows, text_file


def export(job: Job) -> Draft:
    """Return a module with the parameters of both triads and a function that corrects."""
    corrections = job.corrections(job.free_frame).without_g_sensitivity()
    si = job.in_si(corrections)
    lines = [
        '"""Inertial sensor parameters for pyins, in SI, error direction."""',
        *comment([*job.heading(), *job.example(si)]),
        "",
        "import numpy as np",
        "from pyins.inertial_sensor import Parameters",
        "",
    ]
    for triad, correction in si.triads.items():
        lines += [
            f"{triad.upper()} = Parameters(",
            "    transform=np.array([",
            *rows(correction.error_matrix, "        [", "],"),
            "    ]),",
            f"    bias=np.array([{row(correction.offset)}]),",
            ")",
        ]
    # pyins simulates errors and has no function of its own that takes them off again.
    lines += [
        "",
        "def correct(parameters, readings):",
        '    """Return corrected rates, shape (n, 3)."""',
        "    return np.linalg.solve(parameters.transform, (np.asarray(readings) - parameters.bias).T).T",
    ]
    return Draft(files={"imufield_pyins.py": text_file(lines)}, target_model=corrections)
