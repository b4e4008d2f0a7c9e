"""Checksums of whole blocks against byte-by-byte ones."""

from __future__ import annotations

import zlib

import crccheck.crc
import numpy as np
import pytest

from imufield.acquire.protocol.checksum import _EXACT_IN_SINGLE, Crc, checksum_names, make_checksum
from imufield.errors import ProtocolError, Reason
from tests.refused import refused

CRC_NAMES = [name for name in checksum_names() if name.startswith("CRC")]


def _frames(n: int, longest: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    lengths = rng.integers(1, longest + 1, n)
    starts = np.cumsum(lengths) - lengths
    return rng.integers(0, 256, int(lengths.sum()), dtype=np.uint8), starts, lengths


@pytest.mark.parametrize("name", CRC_NAMES)
def test_every_crc_of_the_catalogue_agrees_with_the_library(name: str) -> None:
    data, starts, lengths = _frames(20, 50)
    found = make_checksum(name).of_spans(data, starts, lengths)
    library = next(c for c in crccheck.crc.ALLCRCCLASSES if name in c._names)
    wanted = [library.calc(data[s : s + n].tobytes()) for s, n in zip(starts, lengths, strict=True)]
    assert found.tolist() == wanted
    assert int(make_checksum(name).of(b"")) == library.calc(b"")
    rows = np.frombuffer(b"123456789" * 2, dtype=np.uint8).reshape(2, 9)
    assert make_checksum(name).of_rows(rows).tolist() == [library._check_result] * 2


def test_dummy_bytes_are_covered_but_not_sent() -> None:
    crc = make_checksum("CRC-32/MPEG-2", pad_to=4)
    plain = make_checksum("CRC-32/MPEG-2")
    for length in range(1, 14):
        row = np.arange(length, dtype=np.uint8).reshape(1, -1) + 3
        padded = np.concatenate([row, np.zeros((1, -length % 4), dtype=np.uint8)], axis=1)
        assert crc.of_rows(row).tolist() == plain.of_rows(padded).tolist()
        spans = crc.of_spans(row.ravel(), np.array([0]), np.array([length]))
        assert spans.tolist() == crc.of_rows(row).tolist()


def test_rows_may_be_a_strided_view_longer_than_one_batch() -> None:
    crc = make_checksum("CRC-32/MPEG-2")
    data = np.random.default_rng(3).integers(0, 256, 3000 * 12, dtype=np.uint8)
    view = data.reshape(3000, 12)[:, 2:9]
    one_by_one = [crccheck.crc.Crc32Mpeg2.calc(row.tobytes()) for row in view]
    assert crc.of_rows(view).tolist() == one_by_one


def _fletcher(frame: bytes) -> int:
    first = second = 0
    for byte in frame:
        first = (first + byte) % 256
        second = (second + first) % 256
    return first << 8 | second


def _words(frame: bytes) -> int:
    return sum(frame[i] | frame[i + 1] << 8 for i in range(0, len(frame), 2)) % 65536


def _xor(frame: bytes) -> int:
    value = 0
    for byte in frame:
        value ^= byte
    return value


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("SUM-8", lambda f: sum(f) % 256),
        ("SUM-8/NEGATED", lambda f: -sum(f) % 256),
        ("SUM-16", lambda f: sum(f) % 65536),
        ("SUM-32", sum),
        ("SUM-16/WORDS", _words),
        ("XOR-8", _xor),
        ("FLETCHER-16/MOD-256", _fletcher),
    ],
)
def test_plain_sums_agree_with_a_byte_loop(name: str, reference: object) -> None:
    data, starts, lengths = _frames(30, 300)
    lengths = lengths - lengths % 2
    starts, lengths = starts[lengths > 0], lengths[lengths > 0]
    checksum = make_checksum(name)
    wanted = [reference(data[s : s + n].tobytes()) for s, n in zip(starts, lengths, strict=True)]  # type: ignore[operator]
    assert checksum.of_spans(data, starts, lengths).tolist() == wanted
    for s, n, value in zip(starts, lengths, wanted, strict=True):
        assert checksum.of_rows(data[s : s + n].reshape(1, -1)).tolist() == [value]


def test_single_precision_is_used_as_long_as_it_is_exact() -> None:
    checksum, longest = make_checksum("FLETCHER-16/MOD-256"), _EXACT_IN_SINGLE
    assert 255 * longest * (longest + 1) // 2 < 2**24 <= 255 * (longest + 1) * (longest + 2) // 2
    for length in (longest, longest + 1):
        rows = np.random.default_rng(6).integers(253, 256, (99, length), dtype=np.uint8)
        assert checksum.of_rows(rows).tolist() == [_fletcher(row.tobytes()) for row in rows]


def test_no_span_gives_no_value() -> None:
    nothing = np.empty(0, dtype=np.intp)
    for name in ("CRC-32/MPEG-2", "SUM-8", "XOR-8", "FLETCHER-16/MOD-256"):
        assert len(make_checksum(name).of_spans(np.zeros(4, dtype=np.uint8), nothing, nothing)) == 0


def test_unknown_algorithm_names_the_nearest() -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "CRC-32-MPEG2", "CRC-32/MPEG-2"):
        make_checksum("CRC-32-MPEG2")
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "XOR-8", "pad_to") as caught:
        make_checksum("XOR-8", pad_to=4)
    assert caught.value.values["pad_to"] == 4


def test_long_and_many_lengths_take_bounded_memory() -> None:
    checksum = make_checksum("CRC-32/ISO-HDLC")
    assert isinstance(checksum, Crc)
    rng = np.random.default_rng(5)
    for length in [*range(100, 180), 2047, 2048, 2049, 5000]:
        rows = rng.integers(0, 256, (2, length), dtype=np.uint8)
        assert [int(value) for value in checksum.of_rows(rows)] == [zlib.crc32(row.tobytes()) for row in rows]
    assert checksum._flat.nbytes < 4 << 20
    assert len(checksum._left) < 8192
