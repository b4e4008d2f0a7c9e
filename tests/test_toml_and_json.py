"""TOML and JSON that others wrote: whatever stands in a file, a document or one sentence with file and line."""

from __future__ import annotations

import json
import os
import random
import time
from contextlib import suppress
from pathlib import Path

import pytest

from imufield.acquire.protocol.protocol import parse_protocol
from imufield.acquire.recording.session import Session
from imufield.commands.options.configuration import default_map
from imufield.deliver.parameters.read import read_document
from imufield.errors import ParameterFileError, ProtocolError, RecordingError, UsageError
from imufield.guide.positions import read_positions
from imufield.toml_and_json import DEEPEST, decode_toml, parse_json, parse_toml
from tests.refused import refused

FUZZ_S = float(os.environ.get("IMUFIELD_FUZZ_S", "1"))
"""Of processor time for each test that has no end of its own."""

HOSTILE = {
    "integer of 330 digits": ("integer", "a = 1\nb = " + "9" * 330),
    "integer of 5000 digits": ("integer", "a = 1\nb = " + "9" * 5000),
    "hexadecimal of 5000 digits": ("integer", "a = 1\nb = 0x" + "f" * 5000),
    "integer below 64 bits": ("integer", "a = 1\nb = -9223372036854775809"),
    "integer in a table in an array": ("integer", "a = 1\nb = [{ c = 18446744073709551616 }]"),
    "3000 arrays": ("nested", "a = 1\nb = " + "[" * 3000 + "]" * 3000),
    "arrays without end": ("nested", "a = 1\nb = " + "[" * 1_000_000),
    "key of 100,000 parts": ("nested", "a = 1\n" + "b." * 100_000 + "b = 1"),
    "quoted key of 100,000 parts": ("nested", "a = 1\n" + '"b" . ' * 100_000 + "b = 1"),
    "key of 100,000 parts that look like numbers": ("nested", "a = 1\n" + "1.1." * 50_000 + "b = 1"),
    "key of parts with numbers in them": ("nested", "a = 1\n" + "1.1a" * 50_000 + " = 1"),
    "a number of a million digits": ("integer", "a = 1\nb = " + "1" * 1_000_000),
    "header of 100,000 parts": ("nested", "a = 1\n[" + "b." * 100_000 + "b]\n"),
    "keys of many parts in each other": ("nested", "a = 1\nb" + ".b = {b.b.b.b.b.b.b.b.b.b.b.b" * 5 + " = 1" + "}" * 5),
    "a table below a deep header": ("nested", "[b" + ".b" * 20 + "]\nc" + ".c" * 20 + " = 1"),
    "no value": ("no_toml", "a = 1\nb = \n"),
    "no UTF-8": ("no_text", b"a = 1\nb = '\xff'"),
}


def read(content: bytes | str, label: str = "a.toml") -> dict[str, object]:
    raw = content if isinstance(content, bytes) else content.encode()
    return parse_toml(decode_toml(raw, label, UsageError), label, UsageError)


@pytest.mark.parametrize(("key", "content"), HOSTILE.values(), ids=list(HOSTILE))
def test_refused_with_file_and_line(key: str, content: bytes | str) -> None:
    with refused(UsageError, None, "a.toml", "line 2", key=f"toml_and_json.{key}"):
        read(content)


def test_what_stands_in_texts_and_comments_counts_for_nothing() -> None:
    brackets = "[" * 100 + "." * 100
    lines = (f"# {brackets}", f"a = '{brackets}'", rf'b = "{brackets}\""', f"c = ''''{brackets}'''", rf'd = """\"{brackets}"""')
    text = "\n".join(lines)
    assert read(text) == {"a": brackets, "b": brackets + '"', "c": f"'{brackets}", "d": f'"{brackets}'}


def test_the_last_that_is_allowed() -> None:
    assert read("\ufeffa = [-9223372036854775808, 18446744073709551615]") == {"a": [-(2**63), 2**64 - 1]}
    read("a = " + "[" * DEEPEST + "]" * DEEPEST)
    read("a" + ".a" * (DEEPEST - 1) + " = [1]")


@pytest.mark.parametrize(("key", "content"), HOSTILE.values(), ids=list(HOSTILE))
def test_every_reader_of_such_files_refuses_the_same(
    key: str, content: bytes | str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    raw = content if isinstance(content, bytes) else content.encode()
    for name in ("session.toml", "parameters.toml", "positions.toml", "imufield.toml"):
        Path(name).write_bytes(raw)
    with refused(RecordingError, None, "session.toml", "line 2", key=f"toml_and_json.{key}"):
        Session.open(tmp_path)
    # Which of these files it is not, is said of those that are named on command lines.
    own = {"no_toml": ("no_parameter_file", "no_protocol_file")}.get(key, (key, key))
    with refused(ParameterFileError, None, "parameters.toml", "line 2", key=f"toml_and_json.{own[0]}"):
        read_document("parameters.toml")
    with refused(UsageError, None, "positions.toml", "line 2", key=f"toml_and_json.{key}"):
        read_positions(Path("positions.toml"))
    with refused(UsageError, None, "imufield.toml", "line 2", key=f"toml_and_json.{key}"):
        default_map()
    with refused(ProtocolError, None, "protocol", "line 2", key=f"toml_and_json.{own[1]}"):
        parse_protocol(decode_toml(raw, "protocol", ProtocolError), label="protocol")


PIECES = (
    *"[]{}=.,\n\"'#\\ \t\r_-+:0123456789abefnTxZ\x00\x7f\u00e9\ufeff",
    *('"""', "'''", "[[", "]]", "a.", "a = ", "[a]\n", "inf", "nan", "true", "1e400", "5e-324", "0x", "\\u"),
    *(
        "1979-05-27",
        "07:32:00",
        "9999-99-99T99:99:99.999999+99:99",
        "[" * 40,
        "a." * 40,
        "9" * 400,
        "9" * 5000,
        "0b",
        "\\ud800",
        "\\U00110000",
    ),
)


def documents() -> list[bytes]:
    """Return documents that damage starts from: shipped protocols and what the hostile ones are."""
    protocols = sorted((Path(__file__).parent.parent / "protocols").glob("*.toml"))[:6]
    return [path.read_bytes() for path in protocols] + [b'a = 1\n[b]\nc = "d"\n[[e]]\nf = {g = [1, 2.5]}\n']


def damaged(generator: random.Random, content: bytes) -> bytes:
    """Return a document with some places cut, doubled or written over."""
    raw = bytearray(content)
    for _ in range(generator.randint(1, 6)):
        at = generator.randint(0, len(raw))
        piece = generator.choice(PIECES).encode() if generator.random() < 0.8 else generator.randbytes(3)
        raw[at : at + generator.choice((0, 0, 1, 5, 200))] = piece * generator.choice((1, 1, 1, 2, 50))
    return bytes(raw)


def test_any_file_gives_a_document_or_a_sentence() -> None:
    generator, begin = random.Random(14), time.process_time()
    whole = documents()
    while time.process_time() - begin < FUZZ_S:
        if generator.random() < 0.5:
            content = "".join(generator.choices(PIECES, k=generator.randint(1, 60))).encode()
        else:
            content = damaged(generator, generator.choice(whole))
        # Anything else that comes up is a defect.
        with suppress(ProtocolError):
            text = decode_toml(content, "a.toml", ProtocolError)
            # What comes out can be walked through recursively.
            assert repr(parse_toml(text, "a.toml", ProtocolError))
            parse_protocol(text)


@pytest.mark.parametrize(
    "before", ["#" + " " * 1_000_000, "#" + '" "=' * 250_000, "#" + " \n#" * 300_000, "# " + "1" * 4299 + "\n"]
)
def test_a_line_is_found_in_no_more_time_than_the_text_is_long(before: str) -> None:
    """A search that begins again at each of a million characters would not come to its end here."""
    text = before * (1 if len(before) > 5000 else 200) + '\n" " = 18446744073709551616\n'
    with refused(ProtocolError, key="toml_and_json.integer"):
        parse_toml(text, "a.toml", ProtocolError)


@pytest.mark.parametrize("value", [7, None, "text", [1, {"a": [2.5, []]}], {"a": {"b": [{}]}}])
def test_what_is_json_comes_back(value: object) -> None:
    assert parse_json(json.dumps(value)) == value


def test_the_deepest_that_is_taken() -> None:
    assert parse_json("[" * DEEPEST + "]" * DEEPEST) is not None


# The last is beyond what the parser itself can take.
@pytest.mark.parametrize("levels", [DEEPEST + 1, 900, 100_000])
@pytest.mark.parametrize(("begin", "end"), [("[", "]"), ('{"a":', "}")])
def test_what_is_nested_deeper_is_refused(begin: str, end: str, levels: int) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of any kind
        parse_json(begin * levels + "1" + end * levels)


def test_what_is_none_is_refused() -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of any kind
        parse_json(b"\xff{")
