"""Read numbers from text files: CSV or columns separated by blanks or bars, with or without a header, also packed by gzip.

A file is read in blocks of whole lines. Where they are alike, their digits are added up at once; else NumPy's C parser turns
them into numbers (4 million a second). Single lines are examined only to name the one that is wrong.
"""

from __future__ import annotations

import codecs
import errno
import gzip
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

import numpy as np

from imufield.acquire.formats.foreign_file_reader import SoundGzip
from imufield.acquire.formats.table_cells import delimiter_of, is_number, seconds_of_date, split_cells, without_quotes
from imufield.acquire.formats.table_digits import read_alike
from imufield.dataclass import dataclass, field
from imufield.errors import Reason, RecordingError
from imufield.files import open_to_read
from imufield.progress import task
from imufield.samples import FloatArray
from imufield.sentences import Sentences, printable, shortened

sentence = Sentences(__package__)

BLOCK_BYTES = 1 << 20
"""Text parsed at a time: bounds the memory beside the numbers themselves, and is in the processor's cache still."""
HEAD_BYTES = 64 << 10
"""A header stands within this."""
LINE_LIMIT_BYTES = 1 << 20
"""No table has longer lines; a file without line ends is not one."""
_GZIP_MAGIC = b"\x1f\x8b"
_COMMENT_MARKS = ("#", "%", "//")
# 1.009,81 and 1,009.81, 1.000.000 and 1'009; but 1,009 may be 1.009.
_THOUSANDS = re.compile(
    r"[+-]?\d{1,3}(?:(?:['\u2019\s]\d{3})+(?:[.,]\d*)?|(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:\.\d{3}){2,}|(?:,\d{3}){2,})"
)
ROWS_LOOKED_AT = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable:
    """A table whose shape is known and whose numbers are not read yet.

    Attributes
    ----------
    path : Path
    delimiter : str or None
        None for blanks and tabs.
    header : tuple of str or None
        Names of the columns.
    units : tuple of str or None
        A second header line, where there is one.
    width : int
        Number of columns.
    lines_before : int
        Lines before the first row.
    decimal_comma : bool
        Numbers are written 1,5 and cells separated by semicolons or bars.
    head : tuple of tuple of str
        The cells of the first rows.
    text_columns : frozenset of int
        Those without a number in any of these, e.g. dates.
    assumptions : list of str
        Sentences; what is found while rows are read is added.
    """

    path: Path
    delimiter: str | None
    header: tuple[str, ...] | None
    units: tuple[str, ...] | None
    width: int
    lines_before: int
    decimal_comma: bool
    head: tuple[tuple[str, ...], ...]
    text_columns: frozenset[int]
    assumptions: list[str] = field(default_factory=list)

    def blocks(self, columns: Sequence[int]) -> Iterator[FloatArray]:
        """Yield arrays of shape (n, len(columns)); NaN for empty cells.

        Raises
        ------
        RecordingError
            A row is too short, a cell is no number, or the file ends early; names file, line and text.
        """
        line = 0
        for block in _line_blocks(self.path):
            below = block.split(b"\n", max(self.lines_before - line, 0))[-1]
            is_plain = not self.decimal_comma and not self.text_columns and max(columns) < self.width
            alike = read_alike(below, self.delimiter, self.width) if is_plain else None
            if alike is not None:
                yield alike[:, [*columns]]
                line += block.count(b"\n")
                continue
            text = self._clean(block)
            lines = text.split("\n")
            rows = lines[max(self.lines_before - line, 0) :]
            if rows and self._is_cut(rows[-1]):
                said = sentence("table_text.cut", name=self.path.name, line=line + len(lines))
                # A table may be read twice.
                self.assumptions.extend([said] if said not in self.assumptions else [])
                rows.pop()
            if any(_is_row(row) for row in rows):
                yield self._parse(rows, columns, line + len(lines) - len(rows))
            line += len(lines) - 1

    def read(self, columns: Sequence[int]) -> FloatArray:
        """Return all rows, shape (n, len(columns)).

        Raises
        ------
        RecordingError
            As ``blocks``.
        """
        found = list(self.blocks(columns))
        if not found:
            raise _bad("table_text.no_rows", self.path)
        return found[0] if len(found) == 1 else np.concatenate(found)

    def where(self, row: int) -> tuple[int, str]:
        """Return the line of a row, and words for it, for messages."""
        for line, text in enumerate(_lines(self.path), start=1):
            if line <= self.lines_before or not _is_row(text):
                continue
            if row == 0:
                return line, f'line {line}, "{text.strip()[:60]}"'
            row -= 1
        raise IndexError(f"{self.path} has no such row")

    def _clean(self, block: bytes) -> str:
        """Return lines as NumPy's parser reads them: quotes removed, points for decimal commas, "nan" in empty cells."""
        # Most files have none of these; a search is faster than a copy.
        if b'"' in block:
            block = without_quotes(block.decode("latin-1"), self.delimiter).encode("latin-1")
        if self.decimal_comma:
            block = block.replace(b",", b".")
        if self.delimiter is None:
            return block.decode("latin-1")
        mark = self.delimiter.encode()
        block = block.replace(b"\r\n", b"\n")
        # One pass fills every second of several empty cells in a row.
        while mark * 2 in block:
            block = block.replace(mark * 2, mark + b"nan" + mark)
        block = block.replace(mark + b"\n", mark + b"nan\n").replace(b"\n" + mark, b"\nnan" + mark)
        if block.startswith(mark):
            block = b"nan" + block
        return (block + b"nan" if block.endswith(mark) else block).decode("latin-1")

    def _parse(self, rows: list[str], columns: Sequence[int], lines_before: int) -> FloatArray:
        # Without a choice NumPy notices rows of other widths itself; with one it would read them shifted.
        use = None if list(columns) == list(range(self.width)) else tuple(columns)
        if use is not None and any(map(self._has_other_width, rows)):
            raise self._find_fault(rows, columns, lines_before)
        try:
            # A time that is no number is a date; other columns of text are not read.
            dates: dict[int | str, Callable[[str], float]] = dict.fromkeys(
                self.text_columns.intersection(columns), seconds_of_date
            )
            values = np.loadtxt(rows, delimiter=self.delimiter, converters=dates, usecols=use, ndmin=2)
        except ValueError as error:
            raise self._find_fault(rows, columns, lines_before) from error
        if values.shape[1] != len(columns):
            raise self._find_fault(rows, columns, lines_before)
        return values

    def _is_cut(self, last: str) -> bool:
        """Whether a line without an end, which is the last of a file, is too short for a row."""
        cells = split_cells(last, self.delimiter)
        return _is_row(last) and (len(cells) < self.width or not (is_number(cells[-1]) or self.width - 1 in self.text_columns))

    def _has_other_width(self, row: str) -> bool:
        before, mark, _ = row.partition("#")
        # A comment follows the mark, but in a column of text it may be part of a cell.
        is_text = bool(mark) and len(split_cells(f"{before}{mark}", self.delimiter)) - 1 in self.text_columns
        return self._differs(before) and not (is_text and not self._differs(row))

    def _differs(self, row: str) -> bool:
        # The usual case costs a tenth of a division.
        if self.delimiter is not None and row.count(self.delimiter) == self.width - 1:
            return False
        if not row.strip():
            return False
        cells = split_cells(row.strip(" \r"), self.delimiter)
        # Empty cells behind the others shift nothing.
        filled = max((place for place, cell in enumerate(cells, start=1) if cell not in ("", "nan")), default=0)
        return not filled <= self.width <= len(cells)

    def _find_fault(self, rows: list[str], columns: Sequence[int], lines_before: int) -> RecordingError:
        """Name the first line that is not a row of the table, or what the heading promises more than the rows hold."""
        # Damaged gzip gives wrong lines first; its checksum, at the end, is what tells the fault.
        for _ in read_pieces(self.path, BLOCK_BYTES) if _is_packed(self.path) else ():
            pass
        if max(columns) >= self.width:
            told = {"width": self.width, "named": len(self.header or ()), "line": lines_before + 1}
            return _bad("table_text.narrow_rows", self.path, **told)
        for number, row in enumerate(rows, start=lines_before + 1):
            text = row.split("#")[0].strip()
            if not text:
                continue
            cells = split_cells(text, self.delimiter)
            wrong = next(
                (column for column in columns if len(cells) == self.width and not self._is_readable(cells, column)), None
            )
            if len(cells) == self.width and wrong is None:
                continue
            written = next(islice(_lines(self.path), number - 1, None)).strip(" \r")
            if wrong is None:
                shown = {"found": len(cells), "width": self.width, "line": number, "text": shortened(written)}
                return _bad("table_text.other_width", self.path, **shown)
            # What parts cells stands in quotes, too.
            hidden = split_cells(without_quotes(written, self.delimiter, "\0"), self.delimiter)[wrong]
            cell = hidden.replace("\0", self.delimiter or " ")
            key = "table_text.thousands" if _THOUSANDS.fullmatch(cell) else "table_text.no_number"
            return _bad(key, self.path, text=shortened(cell), line=number)
        return _bad("table_text.bad_row", self.path, line=lines_before)

    def _is_readable(self, cells: Sequence[str], column: int) -> bool:
        if column not in self.text_columns:
            return is_number(cells[column])
        try:
            seconds_of_date(cells[column])
        except ValueError:
            return False
        return True


def open_table(path: str | Path) -> TextTable:
    """Find delimiter, header and number of columns of a file.

    Raises
    ------
    RecordingError
        The file cannot be read, is not text, or holds no numbers.
    """
    path = Path(path)
    comments, texts = _head_lines(path)
    first = _first_row(path, texts)
    names = [line.strip() for _, line in texts[:first]]
    number, line = texts[first]
    delimiter, decimal_comma = _delimiter_below(names, line.strip())
    # The last line may be cut.
    sound = texts[first : max(len(texts) - 1, first + 1)][:ROWS_LOOKED_AT]
    head_rows = tuple(tuple(_first_cells(row.replace(",", ".") if decimal_comma else row, delimiter)) for _, row in sound)
    cells = _first_cells(line, delimiter)
    below = [_first_cells(row.split("#", 1)[0], delimiter) for _, row in sound[1:]]
    if len(below) > 1 and len({*map(len, below)}) == 1 and len(cells) < len(below[0]):
        line, cells = sound[1][1], below[0]  # Reading reports the short first row.
    header, units = _header(path, names, comments, delimiter=delimiter, width=len(cells))
    if header is not None and len(header) < len(cells):
        # Of a comment behind the row nothing is read; what ends a row with a delimiter names no column.
        cells = _first_cells(line.split("#", 1)[0], delimiter)
        header += ("",) * (len(cells) - len(header) if not any(cells[len(header) :]) else 0)
    return TextTable(
        path=path,
        delimiter=delimiter,
        header=header,
        units=units,
        width=len(cells),
        lines_before=number,
        decimal_comma=decimal_comma,
        head=head_rows,
        text_columns=frozenset(
            column for column in range(len(cells)) if not any(is_number(row[column]) for row in head_rows if column < len(row))
        ),
    )


def _head_lines(path: Path) -> tuple[list[str], list[tuple[int, str]]]:
    """Return the comments in the head of a file, and its other lines that are not empty, each with its number."""
    head = next(read_pieces(path, HEAD_BYTES), b"")
    if b"\0" in head:
        raise _bad("table_text.no_text", path)
    lines = _decoded(head.removeprefix(codecs.BOM_UTF8)).split("\n")
    # A head that is not the whole file may end within a line.
    if len(head) == HEAD_BYTES and len(lines) > 1:
        lines.pop()
    comments: list[str] = []
    texts: list[tuple[int, str]] = []
    for number, line in enumerate(lines):
        text = line.strip()
        mark = next((mark for mark in _COMMENT_MARKS if text.startswith(mark)), None)
        if mark is not None:
            comments.append(text.lstrip(mark).strip())
        elif text:
            texts.append((number, line))
    return comments, texts


def _first_row(path: Path, texts: list[tuple[int, str]]) -> int:
    """Return which of the lines is the first row: what stands above the rows may hold numbers, too, but fewer."""
    places = range(len(texts))

    def with_numbers(some: range) -> list[_Shape]:
        return sorted(shape for place in some if (shape := _shape(texts, place)).numbers)

    # The last lines tell the shape of a row, where they are no notes below the rows.
    rows = with_numbers(places[-ROWS_LOOKED_AT:]) or with_numbers(places)
    if not rows:
        raise _bad("table_text.no_rows", path)
    usual = rows[len(rows) // 2]

    def is_row(shape: _Shape) -> bool:
        # A line of numbers alone is a row, if a wrong one.
        is_of_numbers_alone, is_as_wide = shape.numbers == shape.cells, shape.cells == usual.cells
        return shape.numbers > 0 and (is_of_numbers_alone or is_as_wide or 2 * shape.numbers >= usual.numbers)

    return next(place for place in places if is_row(_shape(texts, place)))


class _Shape(NamedTuple):
    """How many cells of a line are numbers, none in a line of names, and how many there are."""

    numbers: int
    cells: int


def _shape(texts: list[tuple[int, str]], place: int) -> _Shape:
    line = texts[place][1]
    delimiter, decimal_comma = _delimiter_below([text.strip() for _, text in texts[:1]], line.strip())
    cells = _first_cells(line, delimiter)
    if _are_names(line.strip(), delimiter, [text for _, text in texts[place + 1 : place + 2]]):
        return _Shape(0, len(cells))
    found = (cell.replace(",", ".") if decimal_comma else cell for cell in cells)
    return _Shape(sum(map(is_number, filter(None, found))), len(cells))


def _decoded(head: bytes) -> str:
    """Return the start of a text in UTF-8, whose last character may be cut, or as spreadsheets of Windows write it."""
    try:
        return codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return head.decode("cp1252", errors="replace")


def _delimiter_below(names: list[str], line: str) -> tuple[str | None, bool]:
    """Return what ``delimiter_of`` does of the first row below some names."""
    delimiter, decimal_comma = delimiter_of(line)
    # Blanks inside cells part nothing where as many names are parted by tabs.
    by_tabs = delimiter is None and "\t" in line and any(name.count("\t") == line.count("\t") for name in names)
    return "\t" if by_tabs else delimiter, decimal_comma


def _first_cells(line: str, delimiter: str | None) -> list[str]:
    # Tabs at the end are cells, where tabs part them.
    return split_cells(without_quotes(line.strip(" \r" if delimiter == "\t" else None), delimiter), delimiter)


def _are_names(line: str, delimiter: str | None, below: list[str]) -> bool:
    """Whether a line of numbers is one of names: all in quotes, above a line without any."""
    return all(cell.startswith('"') for cell in split_cells(line, delimiter)) and bool(below) and '"' not in below[0]


def _header(
    path: Path, names: list[str], marked: list[str], *, delimiter: str | None, width: int
) -> tuple[tuple[str, ...] | None, tuple[str, ...] | None]:
    """Return names and units: the lines before the numbers, or the last commented line that has a name for each column."""
    if names:
        # A title is words: what parts the cells of the rows is not in it, or hardly anything stands between.
        parted = [line for line in names if delimiter is not None and delimiter in line] or names
        rows = [_names(line, delimiter, width) for line in parted]
        usual = width if any(len(cells) == width for cells in rows) else max(map(len, rows))
        wide = [cells for cells in rows if len(cells) == usual]
        while len(wide) > 1 and 2 * sum(map(bool, wide[0])) <= usual:
            wide.pop(0)
        header, *below = wide
        if len(below) > 1:
            raise _bad("table_text.long_heading", path, lines=len(names), text=shortened(names[0]))
        return header, below[0] if below else None
    # Comments may hold anything; the one right above the numbers is the likeliest heading.
    found = (_names(line, delimiter, width) for line in reversed(marked))
    return next((cells for cells in found if len(cells) == width and not any(map(is_number, cells))), None), None


def _names(line: str, delimiter: str | None, width: int) -> tuple[str, ...]:
    """Return the cells of a line of names: parted as the rows are if that makes as many, else by what the line has itself."""
    own = delimiter_of(line)[0]
    # Blanks may stand in names, and part rows below a line that commas part.
    ways = (split_cells(line, mark) for mark in (delimiter or own, own, None))
    cells = next((cells for cells in ways if len(cells) == width), split_cells(line, own))
    return tuple(printable(cell.strip('" ')) for cell in cells)


def _is_row(line: str) -> bool:
    text = line.strip()
    return bool(text) and not text.startswith("#")


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file as they stand in it."""
    for block in _line_blocks(path):
        yield from _decoded(block).removesuffix("\n").split("\n")


def _line_blocks(path: Path) -> Iterator[bytes]:
    """Yield blocks of whole lines; the last one may lack its line end."""
    rest, mark = b"", codecs.BOM_UTF8  # Some programs put it in front of UTF-8.
    for read in read_pieces(path, BLOCK_BYTES):
        piece, mark = read.removeprefix(mark), b""
        end = piece.rfind(b"\n") + 1
        if end:
            yield rest + piece[:end]
            rest = piece[end:]
        else:
            rest += piece
        if len(rest) > LINE_LIMIT_BYTES:
            raise _bad("table_text.long_line", path, limit=LINE_LIMIT_BYTES)
    if rest:
        yield rest


def _is_packed(path: Path) -> bool:
    with open_to_read(path) as raw:
        return raw.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC


def read_pieces(path: Path, size: int) -> Iterator[bytes]:
    """Yield the unpacked content of a file; what the content starts with decides, not the name.

    Raises
    ------
    RecordingError
        The file cannot be read, or its packing is damaged.
    """
    try:
        with open_to_read(path) as raw:
            start = raw.read(len(_GZIP_MAGIC))
            packed = start == _GZIP_MAGIC
            raw.seek(0)
            file = cast("BinaryIO", SoundGzip(fileobj=raw)) if packed else raw
            if start in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
                # As PowerShell redirects and Excel's Unicode text are written.
                file = cast("BinaryIO", codecs.EncodedFile(raw, "utf-8", "utf-16"))
            with task(f"reading {path.name}", path.stat().st_size) as reading:
                while piece := file.read(size):
                    yield piece
                    reading.done = raw.tell()
    except OverflowError as error:
        raise RecordingError(sentence("table_text.too_packed", path=str(path), cause=error), Reason.DAMAGED) from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise RecordingError(sentence("table_text.bad_gzip", path=str(path), cause=error), Reason.DAMAGED) from error
    except UnicodeError as error:
        raise _bad("table_text.no_text", path) from error
    except OSError as error:
        raise unreadable(path, error) from error


def unreadable(path: Path, error: OSError) -> RecordingError:
    """Return why the system does not let a file be read."""
    return _bad("table_text.folder" if error.errno == errno.EISDIR else "table_text.unreadable", path, cause=error.strerror)


def _bad(key: str, path: Path, **values: object) -> RecordingError:
    return RecordingError(sentence(key, path=str(path), **values), Reason.BAD_DATA)
