"""Fields of every type at every place of a frame."""

from __future__ import annotations

import struct
from typing import Literal

import numpy as np
import pytest

from imufield.acquire.protocol.layout import NUMBER_BYTES, Bits, Field, FieldPair, Frames, Layout

RNG = np.random.default_rng(6)


@pytest.mark.parametrize("big_endian", [True, False])
@pytest.mark.parametrize(
    ("kind", "code"),
    [("u8", "B"), ("i8", "b"), ("u16", "H"), ("i16", "h"), ("u32", "I"), ("i32", "i"), ("u64", "Q"), ("i64", "q")],
)
def test_integers(kind: str, code: str, big_endian: bool) -> None:
    size = struct.calcsize("<" + code)
    rows = RNG.integers(0, 256, (20, 3 * size + 5), dtype=np.uint8)
    field = Field(name="f", type=kind, at=5, count=3, size=3 * size, big_endian=big_endian)
    wanted = [struct.unpack_from((">" if big_endian else "<") + "3" + code, row.tobytes(), 5) for row in rows]
    assert field.raw(Frames.of(rows)).tolist() == [list(row) for row in wanted]


@pytest.mark.parametrize("big_endian", [True, False])
@pytest.mark.parametrize("kind", ["u24", "i24"])
@pytest.mark.parametrize(("at", "length"), [(0, 9), (0, 12), (2, 11), (3, 20)])
def test_three_byte_integers_also_at_both_ends(kind: str, big_endian: bool, at: int, length: int) -> None:
    rows = RNG.integers(0, 256, (20, length + 3), dtype=np.uint8)[:, 3:]
    field = Field(name="f", type=kind, at=at, count=3, size=9, big_endian=big_endian)
    order: Literal["big", "little"] = "big" if big_endian else "little"
    wanted = [
        [int.from_bytes(row[at + 3 * i : at + 3 * i + 3].tobytes(), order, signed=kind == "i24") for i in range(3)]
        for row in rows
    ]
    assert field.raw(Frames.of(rows)).tolist() == wanted
    assert Field(name="f", type=kind, at=at, count=1, size=3, big_endian=big_endian).raw(Frames.of(rows)).tolist() == [
        row[0] for row in wanted
    ]


@pytest.mark.parametrize("big_endian", [True, False])
def test_floats_and_scaling(big_endian: bool) -> None:
    order = ">" if big_endian else "<"
    values = np.array([[1.5, -2.25, 1e-3]])
    for kind in ("f32", "f64"):
        row = np.frombuffer(
            b"\x93" + values.astype(f"{order}f{kind[1:]}".replace("f32", "f4").replace("f64", "f8")).tobytes(), np.uint8
        )
        field = Field(name="f", type=kind, at=1, count=3, size=len(row) - 1, big_endian=big_endian, factor=2.0, offset=1.0)
        np.testing.assert_allclose(field.values(Frames.of(row.reshape(1, -1))), values * 2 + 1, rtol=1e-6)


def test_text_and_bits_are_described() -> None:
    layout = Layout(
        "info",
        (
            Field(name="name", type="ascii", at=0, size=4),
            Field(name="number", type="bcd", at=4, size=2),
            Field(name="rest", type="bytes", at=6, size=2),
            Field(name="flags", type="u8", at=8, size=1, bits=(Bits("low", 0, 2, ("a", "b")), Bits("high", 7, 1))),
            Field(name="temperature", type="i16", at=9, size=2, factor=1 / 256, unit="degC"),
        ),
        11,
    )
    assert layout.describe(b"AB \x00\x12\x34\xbe\xef\x81\x19\x80") == {
        "name": "AB",
        "number": "1234",
        "rest": "beef",
        "flags": 0x81,
        "low": "b",
        "high": 1,
        "temperature": 0x1980,
        "temperature [degC]": 25.5,
    }
    assert Bits("low", 0, 2, ("a", "b")).of(3) is None
    assert layout.field("flags") is not None
    assert layout.field("none") is None


@pytest.mark.parametrize("big_endian", [True, False])
@pytest.mark.parametrize("kind", ["u8", "i16", "u24", "i24", "f32", "f64"])
@pytest.mark.parametrize("is_reversed", [False, True])
def test_two_fields_at_once_are_as_one_after_the_other(kind: str, big_endian: bool, is_reversed: bool) -> None:
    size = 3 * NUMBER_BYTES[kind]
    rows = RNG.integers(0, 256, (9, 2 * size + 5), dtype=np.uint8)
    fields = [Field(name="f", type=kind, at=at, count=3, size=size, big_endian=big_endian) for at in (1, size + 3)]
    first, second = fields[::-1] if is_reversed else fields
    assert FieldPair.fits(first, second, rows.shape[1])
    frames = Frames.of(rows)
    # Bits may be no number, which equals nothing.
    np.testing.assert_array_equal(FieldPair(first, second).raw(frames), [first.raw(frames), second.raw(frames)])


def test_a_field_whose_neighbour_is_missing_is_read_alone() -> None:
    first, second = (Field(name="f", type="u24", at=at, count=3, size=9) for at in (0, 9))
    assert not FieldPair.fits(first, second, 18)
    assert FieldPair.fits(first, second, 19)
