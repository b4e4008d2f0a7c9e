"""``imufield noise``: noise density, bias instability and bias random walk of hours of standstill."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import get_args

import numpy as np

from imufield.acquire.decoded_session import session_protocol
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session, open_or_newest
from imufield.calibrate.noise.noise import NoiseResult, measure_noise
from imufield.calibrate.noise.noise_fit import NoiseFigure
from imufield.calibrate.noise.noise_texts import NoiseFormat, draw_plot, noise_text
from imufield.commands.options.result_commands import NoiseOptions
from imufield.commands.options.shared import one_of
from imufield.commands.terminal.output import echo, say, say_each, tell_written, write_output
from imufield.dataclass import replace
from imufield.deliver.parameters.document import noise_table
from imufield.deliver.parameters.file import Noise, Parameters, load, write_document
from imufield.deliver.parameters.printed_numbers import beside
from imufield.errors import Reason, UsageError
from imufield.files import refuse_overwriting, source_date
from imufield.pipeline.chain import session_samples
from imufield.pipeline.damage import naming_damage
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Scale = FloatArray | float | None

# Title of each figure, and what its unit has behind that of the axis.
_FIGURES = {
    "density": ("density", "/sqrt(Hz)"),
    "instability": ("bias instability", ""),
    "walk": ("bias random walk", "/sqrt(s)"),
}


def run_noise(options: NoiseOptions) -> None:
    """Measure and print; write what other filters read, the plot, and the parameter file's table where asked for.

    Raises
    ------
    ImufieldError
        If the session cannot be read, or is too short.
    """
    form: NoiseFormat = one_of("to", options.to, get_args(NoiseFormat))
    # Before allantools: what it imports ends at such a date.
    source_date()
    parameters = None if options.parameters is None else load(options.parameters)
    session = open_or_newest(options.session)
    if options.session is None and not options.as_json:
        # The newest, which a person may not expect.
        echo(beside("session", session.folder))
    scales_and_zero = _scales_and_zero(session, parameters)
    # Before an hour of samples is read for nothing.
    for path in filter(None, (options.output, options.plot)):
        refuse_overwriting(path, [*session.parts, *filter(None, [options.parameters])])
    damage: list[Damage] = []
    with naming_damage(session, damage):
        result = measure_noise(session_samples(session, damage), *scales_and_zero)
    say_each((entry.what for entry in damage), err=True)
    if options.output is not None:
        write_output(options.output, noise_text(result, form).encode(), as_json=options.as_json)
    if options.plot is not None:
        picture = draw_plot(result, options.plot.suffix.removeprefix(".").lower() or "png")
        write_output(options.plot, picture, as_json=options.as_json)
    if options.parameters is not None and parameters is not None:
        path = parameters.path or options.parameters
        if note := parameters.instrument_note(session.record.instrument, session.sha256):
            say(note, err=True)
        tell_written(path, _write_into(path, parameters, result), as_json=options.as_json)
    if options.as_json:
        echo(json.dumps(_document(result)))
        return
    _print(result)


def _scales_and_zero(session: Session, parameters: Parameters | None) -> tuple[Scale, Scale, FloatArray]:
    """Return raw units per SI of both triads, and the accelerometer's raw output at zero input, shape (3,).

    Calibrated ones where there are parameters, else what protocol and session state.

    Raises
    ------
    ParameterFileError
        If the parameters are those of another instrument or of other raw units.
    """
    protocol = session_protocol(session)
    if parameters is None:
        stated = session.record.nominal.raw_zero
        raw_zero = protocol.raw_zero_rate(None if stated is None else np.array(stated))
        return protocol.nominal.accelerometer_scale, protocol.nominal.gyroscope_scale, raw_zero[:3]
    parameters.check_instrument(session.serial_number)
    parameters.check_unit("accelerometer", protocol.units.accelerometer_rate_unit)
    accelerometer, gyroscope = parameters.calibration.accelerometer, parameters.calibration.gyroscope
    if gyroscope is None or not parameters.gyroscope_is_complete:
        return accelerometer.scale, protocol.nominal.gyroscope_scale, accelerometer.offset
    parameters.check_unit("gyroscope", protocol.units.gyroscope_rate_unit)
    return accelerometer.scale, gyroscope.parameters.scale, accelerometer.offset


def _write_into(path: Path, parameters: Parameters, result: NoiseResult) -> Path | None:
    """Put the figures into the table [noise] of a parameter file; return where the file as it was is kept."""
    if not result.is_si:
        raise UsageError(sentence("noise.no_gyroscope_scale", path=path), Reason.UNITS)
    noise = Noise(
        source=result.source,
        accelerometer_density_m_s2_per_sqrt_hz=result.values("accelerometer", "density"),
        gyroscope_density_rad_s_per_sqrt_hz=result.values("gyroscope", "density"),
        accelerometer_bias_instability_m_s2=result.values("accelerometer", "instability"),
        gyroscope_bias_instability_rad_s=result.values("gyroscope", "instability"),
    )
    earlier = parameters.context.noise
    if earlier is not None and not result.triad("gyroscope"):
        noise = replace(
            noise,
            source=f"{noise.source}; gyroscope: {earlier.source}",
            gyroscope_density_rad_s_per_sqrt_hz=earlier.gyroscope_density_rad_s_per_sqrt_hz,
            gyroscope_bias_instability_rad_s=earlier.gyroscope_bias_instability_rad_s,
        )
    # The hash is of the content as it was; it is written anew.
    document = {key: value for key, value in parameters.document.items() if key != "integrity"}
    return write_document(path, document | {"noise": noise_table(noise)})


def _print(result: NoiseResult) -> None:
    say(f"{result.source} ({result.samples} samples used, {result.bridged or 'none'} interpolated)")
    for name, (title, per) in _FIGURES.items():
        echo(f"{title:<18}{'value':>12}   {'95 % interval':<23} unit")
        for axis in result.axes:
            echo(f"  {axis.name:<16}{_value_and_limits(getattr(axis, name))} {axis.unit}{per}".rstrip())
    rows = [(f"{sheet.triad[:3]} {sheet.title}", map(_in_short, figures), sheet.unit) for sheet, figures in result.data_sheet()]
    for title, cells, unit in [("as in data sheets", AXES, "unit"), *rows] if rows else ():
        echo(f"{title:<29}{''.join(f'{cell:>11}' for cell in cells)}   {unit}")
    say_each((*result.sentences, *(told for axis in result.axes for told in axis.sentences)), indent=3, begin=" · ")


def _value_and_limits(figure: NoiseFigure) -> str:
    """Return the two columns of a figure, 38 characters."""
    if not math.isfinite(figure.value):
        return f"{'not seen':>12}   {f'below {figure.high:.3g}' if math.isfinite(figure.high) else '':<23}"
    return f"{figure.value:>12.3g}   {f'{figure.low:.3g} to {figure.high:.3g}':<23}"


def _in_short(figure: NoiseFigure) -> str:
    if math.isfinite(figure.value):
        return f"{figure.value:.3g}"
    return f"< {figure.high:.2g}" if math.isfinite(figure.high) else "not known"


def _document(result: NoiseResult) -> dict[str, object]:
    def numbers(figure: NoiseFigure) -> dict[str, float | None]:
        values = {"value": figure.value, "low": figure.low, "high": figure.high}
        # JSON knows no NaN: what is not seen is null.
        return {name: value if math.isfinite(value) else None for name, value in values.items()}

    return {
        "source": result.source,
        "duration_s": result.duration_s,
        "rate_hz": result.rate_hz,
        "units": {axis.name: axis.unit for axis in result.axes},
        "axes": {
            axis.name: {name: numbers(getattr(axis, name)) | {"unit": axis.unit + per} for name, (_, per) in _FIGURES.items()}
            for axis in result.axes
        },
        "data_sheet": [
            {"triad": sheet.triad, "figure": sheet.title, "unit": sheet.unit, "axes": [numbers(figure) for figure in figures]}
            for sheet, figures in result.data_sheet()
        ],
        "sentences": [*result.sentences, *(told for axis in result.axes for told in axis.sentences)],
    }
