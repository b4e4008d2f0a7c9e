"""The label on an instrument: serial number, day of calibration, due day, and a code that a phone reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from xml.sax.saxutils import escape

from imufield.deliver.certificate.certificate import Certificate, xml_text
from imufield.errors import load_package
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

_QUIET = 4  # Modules of blank around the code (ISO/IEC 18004).
_WIDTH_MM = 62.0  # A roll of common label printers.
_HEIGHT_MM = 25.0
_TEXT_X_MM = 25.5
_LETTER = 0.62  # Width of a letter over the size of its font, on the average; bold capitals are wider.


def label_text(certificate: Certificate) -> str:
    """Return what the code says."""
    parts = {
        "serial": shortened(certificate.serial_number),
        "calibrated": certificate.calibrated,
        "due": certificate.due,
        "sha256": certificate.short_sha256,
    }
    return "imufield " + " ".join(f"{name}={value}" for name, value in parts.items() if value)


def _runs(row: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield where the dark modules of a row begin, and how many stand together."""
    x = 0
    for is_dark, modules in groupby(row):
        width = len([*modules])
        if is_dark:
            yield x, width
        x += width


def label_svg(certificate: Certificate) -> str:
    """Return the label as SVG, sized in millimetres.

    Raises
    ------
    UsageError
        If segno is not installed.
    """
    segno = load_package("segno", "the label", "web")
    # Left to choose, segno takes Latin-1 or Shift JIS where they hold the text, and a reader has to guess.
    code = segno.make(label_text(certificate), error="m", micro=False, boost_error=False, encoding="utf-8")
    modules = code.symbol_size(scale=1, border=_QUIET)[0]
    dark = "".join(
        f"M{x + _QUIET} {y + _QUIET}h{width}v1h-{width}z" for y, row in enumerate(code.matrix) for x, width in _runs(row)
    )
    lines = [
        (certificate.instrument, 3.2, "bold"),
        (sentence("label.serial_number", serial_number=certificate.serial_number), 2.8, "normal"),
        (sentence("label.calibrated", day=certificate.calibrated), 2.8, "normal"),
        (sentence("label.due", day=certificate.due) if certificate.due else "", 2.8, "normal"),
        (sentence("label.hash", sha256=certificate.short_sha256), 2.2, "normal"),
    ]
    texts, y = [], 2.0
    for text, size, weight in lines:
        if text:
            y += size * 1.45
            shown = xml_text(shortened(text))
            # A long one is set smaller, so that it ends on the label.
            fitting = min(size, (_WIDTH_MM - _TEXT_X_MM - 1) / (_LETTER * len(shown)))
            style = f'font-size="{fitting:.2f}" font-weight="{weight}"'
            texts.append(f'<text x="{_TEXT_X_MM}" y="{y:.2f}" {style}>{escape(shown)}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH_MM:g}mm" height="{_HEIGHT_MM:g}mm" '
        f'viewBox="0 0 {_WIDTH_MM:g} {_HEIGHT_MM:g}" role="img" aria-label="{sentence("label.drawing")}">'
        f'<rect width="{_WIDTH_MM:g}" height="{_HEIGHT_MM:g}" fill="#fff"/>'
        f'<svg width="{_HEIGHT_MM:g}" height="{_HEIGHT_MM:g}" viewBox="0 0 {modules} {modules}"><path d="{dark}"/></svg>'
        f'<g font-family="Helvetica, Arial, sans-serif">{"".join(texts)}</g></svg>\n'
    )
