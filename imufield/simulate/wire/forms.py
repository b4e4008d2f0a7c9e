"""What an emulated instrument sends: the table ``[[emulate]]`` of a protocol file.

Without such a table it is the first kind of frame or sentence that has an accelerometer or a gyroscope, once for each sample;
of a protocol whose lines are all of one kind it is that line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.toml import Source, Table, near, spell
from imufield.dataclass import dataclass, field
from imufield.errors import UsageError
from imufield.limits import RATE_RANGE_HZ
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS
from imufield.sentences import Sentences

sentence = Sentences(__package__)

DEFAULT_RATE_HZ = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WireFrame:
    """One frame of each sample."""

    start: bytes = b""
    """First bytes, which choose among several forms of frames."""
    key: int = 0
    fields: tuple[int, ...] = ()
    """Ids, in order, of a body made of fields."""
    masks: bytes = b""
    """Group byte and masks of a body told by them."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Raw values of fields that mean nothing in a sample; all others are 0."""
    line: str = ""
    """Template of a sentence: a replacement field for each number of a sample, and one for the checksum."""


@dataclass(frozen=True, slots=True)
class WireForm:
    """One way to run the instrument: its frames, and the settings a reader needs for them."""

    name: str
    rate_hz: float
    settings: Mapping[str, object]
    """Settings of the protocol that a reader of this form needs."""
    frames: tuple[WireFrame, ...]


def wire_forms(protocol: Protocol) -> tuple[WireForm, ...]:
    """Return the forms a protocol lists, or the default one.

    Raises
    ------
    ProtocolError
        If the table is not understood, with line and key.
    """
    source = Source(f"protocol {protocol.name}", protocol.text)
    top = Table(values=source.parse(), path=(), source=source)
    found = tuple(_read_form(each) for each in top.tables("emulate"))
    return found or (WireForm("default", protocol.clock.rate_hz or DEFAULT_RATE_HZ, {}, (_first_frame(protocol),)),)


def choose_form(protocol: Protocol, name: str | None, given: Mapping[str, object]) -> WireForm:
    """Return the form of that name; without a name the first that agrees with the settings given.

    Raises
    ------
    UsageError
        If there is none.
    """
    forms = wire_forms(protocol)
    if name is None:
        told = {key: spell(value) for key, value in given.items() if value is not None}
        agreeing = (
            form for form in forms if all(told.get(key, spell(own)) == spell(own) for key, own in form.settings.items())
        )
        return next(agreeing, forms[0])
    found = next((form for form in forms if form.name == name), None)
    if found is None:
        names = [form.name for form in forms]
        raise UsageError(sentence("forms.no_form", protocol=protocol.name, form=name, near=near(name, names), forms=names))
    return found


def number_template(column: str, ticks_per_s: float = 1.0, *, whole: bool = False) -> str:
    """Return how a number of a line is printed where nothing says so.

    Parameters
    ----------
    column : str
        Its name; a minus in front is the sign, alone it means nothing.
    ticks_per_s : float
        Of a time.
    whole : bool
        Outputs are counts.
    """
    name = column.removeprefix("-")
    if name == "":
        return "0"
    if name == "time":
        # Microseconds, whatever the unit of the ticks.
        return f"{{:.{max(0, 6 - round(math.log10(ticks_per_s)))}f}}"
    return {"counter": "{:d}", "temperature": "{:.2f}"}.get(name, "{:.0f}" if whole else "{:.9f}")


def _first_frame(protocol: Protocol) -> WireFrame:
    if protocol.lines is not None and not protocol.lines.sentences:
        return WireFrame()
    wanted = {*protocol.samples.accelerometer.fields, *protocol.samples.gyroscope.fields}
    for form in protocol.frame.forms if protocol.frame else ():
        for key, layout in form.layouts.items():
            if not layout.is_message and any(field.name in wanted for field in layout.fields):
                return WireFrame(start=form.sync, key=key)
    triads = {*ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS}
    rule = protocol.lines
    for known in rule.sentences if rule and rule.checksums else ():
        if rule and triads & {column.removeprefix("-") for column in known.columns}:
            cells = [number_template(column, protocol.clock.time_ticks_per_s) for column in known.columns]
            head = f"{rule.markers[0]}{known.name},{rule.header_end}"
            # Two hexadecimal digits for each byte of the checksum.
            return WireFrame(line=f"{head}{','.join(cells)}*{{:0{2 * rule.checksums[0].size}X}}")
    raise UsageError(sentence("forms.nothing_to_send", protocol=protocol.name))


def _read_form(table: Table) -> WireForm:
    frames = []
    name, rate_hz = table.text("name"), table.number("rate_hz", DEFAULT_RATE_HZ, low=RATE_RANGE_HZ[0], high=RATE_RANGE_HZ[1])
    settings: Mapping[str, object] = table.table("settings").values
    for each in table.tables("frames"):
        values = {name: value for name, value in each.table("values").values.items() if isinstance(value, int | float)}
        frames.append(
            WireFrame(
                start=each.hexadecimal("start"),
                key=int(each.text("key", "0x0"), 16),
                fields=tuple(int(str(identifier), 16) for identifier in each.items("fields", [])),
                masks=each.hexadecimal("masks"),
                values=values,
                line=each.text("line", ""),
            )
        )
        each.finish()
    table.finish()
    return WireForm(name, rate_hz, settings, tuple(frames))
