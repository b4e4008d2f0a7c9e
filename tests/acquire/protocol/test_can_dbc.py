"""Signals: cantools and our arrays say the same of every bit; codes of no value become gaps."""

from __future__ import annotations

import random
from contextlib import suppress
from itertools import pairwise

import cantools
import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from cantools.database.errors import Error

from imufield.acquire.protocol.can_dbc import DbcFile, compile_signal
from imufield.acquire.protocol.can_frame import EXTENDED
from imufield.acquire.protocol.protocol import load_protocol, protocol_names
from imufield.errors import ProtocolError, Reason
from tests.acquire.plain_frames import values_of
from tests.refused import refused

DBC = """VERSION ""
BS_:
BU_: A
BO_ 100 Motion: 8 A
 SG_ Selector M : 0|4@1+ (1,0) [0|15] "" A
 SG_ First m0 : 8|16@1- (0.5,0) [0|0] "g" A
 SG_ Second m1 : 8|16@1- (0.25,0) [0|0] "g" A
 SG_ Always : 31|12@0+ (0.1,-10) [0|0] "deg/s" A

BO_ 200 Other: 4 A
 SG_ Always : 0|16@1+ (1,0) [0|0] "" A
 SG_ TooFar : 24|16@1+ (1,0) [0|0] "" A

VAL_ 100 Always 0 "no error" 4095 "SNA" 4094 "sensor error" 7 "not available" ;
"""


def random_signal(rng: random.Random, width: int) -> Signal:
    is_float = rng.random() < 0.2
    return Signal(
        "s",
        rng.randrange(8 * width),
        rng.choice((16, 32, 64)) if is_float else rng.randint(1, 64),
        rng.choice(("big_endian", "little_endian")),
        rng.random() < 0.5,
        conversion=BaseConversion.factory(scale=rng.choice((1, 0.01, -0.5)), offset=rng.choice((0, -320)), is_float=is_float),
    )


@pytest.mark.parametrize("width", [8, 64])
def test_random_signals_agree_with_cantools(width: int) -> None:
    rng = random.Random(width)
    compared = 0
    while compared < 600:
        signal = random_signal(rng, width)
        try:
            message = Message(1, "m", width, [signal], strict=True)
        except Error:
            continue  # it does not fit
        rows = np.frombuffer(rng.randbytes(3 * width), dtype=np.uint8).reshape(3, width)
        compiled = compile_signal(signal)
        for row, raw, value in zip(rows, compiled.raw(rows), values_of(compiled, rows), strict=True):
            wanted = message.decode(row.tobytes(), scaling=False)["s"]  # type: ignore[call-overload, index, unused-ignore]
            assert raw == wanted or (raw != raw and wanted != wanted), signal
            if np.isfinite(value):
                assert value == pytest.approx(message.decode(row.tobytes())["s"], rel=1e-12, abs=1e-9)  # type: ignore[call-overload, index, unused-ignore]
        compared += 1


@pytest.mark.parametrize("name", [name for name in protocol_names() if load_protocol(name).can is not None])
def test_every_shipped_signal_agrees_with_cantools(name: str) -> None:
    rule = load_protocol(name).can
    assert rule is not None
    rng = np.random.default_rng(5)
    for message, signal in rule.dbc.signals():
        rows = rng.integers(0, 256, (200, 8), dtype=np.uint8)
        values = values_of(signal, rows)
        for row, value in zip(rows, values, strict=True):
            if np.isnan(value):
                continue
            told = rule.dbc.describe(message.name, row.tobytes())[signal.name]
            if not isinstance(told, str):
                assert value == pytest.approx(told, rel=1e-12, abs=1e-9)


def test_the_file_parses_as_cantools_parses_it() -> None:
    # The whole text of a protocol goes through TOML; not a byte of the DBC may change.
    rule = load_protocol("j1939_imu").can
    assert rule is not None
    again = cantools.database.load_string(load_protocol("j1939_imu").text.split("text = '''\n")[1].rsplit("'''", 1)[0], "dbc")
    assert len(again.messages) == 4  # type: ignore[union-attr, unused-ignore]


def test_multiplexed_signals_are_forms_of_their_own() -> None:
    dbc = DbcFile(DBC, "test.dbc")
    message, signal = dbc.find("Second")
    assert (message.can_id, message.mask & EXTENDED) == (100, EXTENDED)
    ((selector, values),) = message.selectors
    assert (selector.name, values, signal.factor) == ("Selector", (1,), 0.25)
    assert dbc.find("Motion.Always")[0].selectors == ()


def test_value_tables_name_codes() -> None:
    _, signal = DbcFile(DBC, "test.dbc").find("Motion.Always")
    codes = {(code.low, code.is_error) for code in signal.codes}
    assert codes == {(4095, False), (4094, True), (7, False)}


@pytest.mark.parametrize(
    ("texts", "wanted"),
    [
        ("Default, noerror, NoError, NO_FAULT, not faulty, Terrain, Antenna, Preserved, Mono signal", set()),
        ("ERR, Error1, sensor_error, ECUError, SensorFault, faulty, failed, Failure, defective", {True}),
        ("ERROR_NO_COMM, FaultNoSupply, Error_No_Ack", {True}),
        ("SENSORERROR, HWFAULT, SIGERR, TIMEOUTERROR, SELFTESTFAILED, DEVICEFAILURE, sensordefect", {True}),
        ("terror, preferred, deferring, Interrupt", set()),
        ("n/a, NA, SNA_1, NotAvailable, NOT-AVAILABLE, SignalInvalid, Reserved2, no_data, undefined", {False}),
    ],
)
def test_value_tables_are_read_by_whole_words(texts: str, wanted: set[bool]) -> None:
    for text in texts.split(", "):
        table = DBC.replace('7 "not available"', f'9 "{text}"')
        _, signal = DbcFile(table, "test.dbc").find("Motion.Always")
        assert {code.is_error for code in signal.codes if code.low == 9} == wanted, text


def test_j1939_codes() -> None:
    rule = load_protocol("j1939_imu").can
    assert rule is not None
    _, signal = rule.dbc.find("YawRate")
    raw = np.array([0, 0xFAFF, 0xFB00, 0xFE00, 0xFEFF, 0xFF00, 0xFFFF])
    rows = np.zeros((7, 8), dtype=np.uint8)
    rows[:, 4:6] = raw.astype("<u2").view(np.uint8).reshape(7, 2)
    missing, fault = signal.gaps(signal.raw(rows))
    assert missing.tolist() == [False, False, True, True, True, True, True]
    assert fault.tolist() == [False, False, False, True, True, False, False]
    # u24 of the slope message: the last valid value is 0xFAFFFF
    _, pitch = rule.dbc.find("PitchAngle")
    assert min(code.low for code in pitch.codes) == 0xFB0000


@pytest.mark.parametrize(
    ("name", "key", "reason", "facts"),
    [
        ("Secnd", "unknown", Reason.UNKNOWN_KEY, ("'Secnd'", "'Second'")),
        ("Moton.First", "unknown", Reason.UNKNOWN_KEY, ("'Moton'", "'Motion'")),
        ("Always", "several", Reason.BAD_PROTOCOL, ("Motion.Always, Other.Always",)),
        ("TooFar", "too_long", Reason.BAD_PROTOCOL, ("TooFar", "byte 5")),
    ],
)
def test_errors_of_names(name: str, key: str, reason: Reason, facts: tuple[str, ...]) -> None:
    with refused(ProtocolError, reason, "test.dbc", *facts, key=f"can_dbc.{key}"):
        DbcFile(DBC, "test.dbc").find(name)


def test_a_message_of_the_transport_protocol_is_refused() -> None:
    text = DBC.replace(" 100 ", f" {0x18FEDA80 | EXTENDED} ").replace("Motion: 8", "Motion: 9")
    dbc = DbcFile(text, "test.dbc", "j1939")
    for find in (dbc.message, lambda name: dbc.find(f"{name}.Always")):
        with refused(ProtocolError, Reason.BAD_PROTOCOL, "test.dbc", key="can_dbc.transported") as caught:
            find("Motion")
        assert (caught.value.values["message"], caught.value.values["size"], caught.value.values["most"]) == ("Motion", 9, 8)
    # A frame of CAN FD holds it.
    assert DbcFile(text, "test.dbc", "exact").find("Motion.Always")[0].can_id == 0x18FEDA80 | EXTENDED
    assert DbcFile(text.replace("Motion: 9", "Motion: 8"), "test.dbc", "j1939").find("Motion.Always")[0].is_j1939


def multiplexed(*statements: str) -> str:
    """Return a DBC file whose signals A to L select each other as the statements say."""
    signals = "".join(f' SG_ {name} m0M : {8 * place}|8@1+ (1,0) [0|0] "" R\n' for place, name in enumerate("ABCDEFGHIJKL"))
    return f'VERSION ""\nBU_: R\nBO_ 100 Force: 12 R\n{signals}' + "".join(f"SG_MUL_VAL_ 100 {each};\n" for each in statements)


LONG_NUMBERS = ("SG_MUL_VAL_ {} A B 0-1;", 'VAL_ 256 A {} "x";', 'VAL_ {} A 1 "x";', "BO_ {} X: 8 V")
FAR_BITS = ("0|2147483648", f"0 | {10**400}", "2147483648|8")


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (multiplexed("A B 0-0", "B A 0-0"), "multiplexed_deep"),
        (multiplexed("A A 0-0"), "multiplexed_deep"),
        (multiplexed(*(f"{below} {above} 0-0" for above, below in pairwise("ABCDEFGHIJKL"))), "multiplexed_deep"),
        (multiplexed("B A 0-0", "B C 1-1"), "two_multiplexers"),
        # Each would be made: four thousand million values, and all combinations of eight bytes.
        (multiplexed("B A 0-4000000000"), "many_forms"),
        (multiplexed("B A 0-1 // of a; comment\n, 2-4000000000"), "many_forms"),
        (multiplexed(*(f"{below} {above} 0-255" for above, below in pairwise("ABCDEFGH"))), "many_forms"),
        (multiplexed("B A 0-65000").replace("SG_MUL", 'VAL_ 100 B 0 "" 1 "";\nSG_MUL'), "many_forms"),
        ("BU_: R\n" + "".join(f"BO_ {2**31 + number} M{number}: 8 R\n" for number in range(40_000)), "many_entries"),
        *((f'BU_: R\nBO_ 100 M: 8 R\n SG_ A : {bits}@1+ (1,0) [0|0] "" R\n', "far_bit") for bits in FAR_BITS),
        *((DBC + text.format("9" * 5000), "long_number") for text in LONG_NUMBERS),
        # Of each character of a text, also of one without an end, cantools takes 240 bytes.
        (DBC + 'CM_ "' + "(" * 100_000 + '";', "long_text"),
        (DBC + 'CM_ "' + "(" * 100_000, "long_text"),
        # Behind each slash of a comment without an end cantools looks for one.
        ("/" * 1_000_000, "unreadable"),
    ],
)
def test_traps_are_refused_before_they_close(text: str, key: str) -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "trap.dbc", key=f"can_dbc.{key}"):
        DbcFile(text, "trap.dbc")


def test_a_multiplexer_that_is_not_there() -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "Force.B", "Z", key="can_dbc.no_multiplexer"):
        DbcFile(multiplexed("B Z 0-1"), "lone.dbc").find("B")


def test_multiplexers_in_each_other() -> None:
    message, _ = DbcFile(multiplexed("B A 0-3", "C B 7-9"), "nested.dbc").find("C")
    assert [(signal.name, {*values}) for signal, values in message.selectors] == [("B", {7, 8, 9}), ("A", {0, 1, 2, 3})]


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("", "unreadable"),
        ("garbage", "unreadable"),
        ("BO_ x", "unreadable"),
        ("BO_ " + "x" * 100_000, "unreadable"),
        (DBC.replace("8|16@1-", "8|x@1-"), "unreadable"),
        ('VERSION ""\nBS_:\nBU_: A\n', "no_message"),
    ],
)
def test_damaged_files_are_refused(text: str, key: str) -> None:
    with refused(ProtocolError, Reason.BAD_PROTOCOL, "bad.dbc", key=f"can_dbc.{key}") as caught:
        DbcFile(text, "bad.dbc")
    assert len(caught.value.message) < 200


@pytest.mark.parametrize("piece", ["1", "SG_MUL_VAL_ 1 a b 0-0, ", "VAL_ 1 a 0 ", " ", ": 1", "SG_ a ", "["])
def test_long_text_takes_no_longer_than_its_length(piece: str) -> None:
    """A search that begins again at each of so many characters would not come to its end here."""
    text = f"{DBC}SG_MUL_VAL_ 1 a b 0-0;\nBO_ {piece * (300_000 // len(piece))}"
    with suppress(ProtocolError):
        DbcFile(text, "a.dbc")
