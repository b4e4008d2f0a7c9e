"""ROS imu_calib (dpkoch): ``SM raw - bias``, accelerometer only, SM by rows."""

from __future__ import annotations

from imufield.deliver.exports.flight_stack import LACKS_GYROSCOPE, bias_only_gyroscope
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, row, text_file


def export(job: Job) -> Draft:
    """Return the YAML that its node apply_calib reads."""
    full = job.corrections(job.free_frame)
    si = job.in_si(full)
    lines = [
        *comment([*job.heading(), *job.example(si)[:1]]),
        f"SM: [{row(si.accelerometer.matrix.ravel().tolist())}]",
        f"bias: [{row(si.accelerometer.output_offset.tolist())}]",
    ]
    held = bias_only_gyroscope(job, full)
    note = ("imu_calib takes the gyroscope's bias from the first still samples at each start (calibrate_gyros)",)
    return Draft(
        files={"imu_calib.yaml": text_file(lines)},
        held=held,
        gyroscope_lacks=LACKS_GYROSCOPE,
        notes=note if full.gyroscope is not None else (),
    )
