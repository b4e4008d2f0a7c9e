"""Every command of a host in the vector files equals what our code sends, and is known to be harmless or never sent."""

from __future__ import annotations

import importlib
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from never_sent import FORBIDDEN

from imufield.acquire.registry import load_driver


def module_of(driver: str) -> Any:
    return importlib.import_module(load_driver(driver).__module__)


def private(name: str) -> Any:
    load_driver("text")
    return importlib.import_module(f"imufield.drivers.{name}")


stim300 = private("_stim300_utility").utility
vectornav = private("_vectornav_registers").with_checksum
xsens = module_of("xsens_mtdata2").request
mip = module_of("microstrain_mip").command
aceinna = module_of("aceinna_serial").packet
witmotion = module_of("witmotion")
aceinna_can = module_of("aceinna_can")

Vector = dict[str, Any]
Rule = tuple[Callable[[Vector], bool], Callable[[Vector], bytes], str]
NEVER = "outlives the power, resets, or changes the bit rate"
FRAMING = "a packet that no driver has a use for; its framing is ours"
SENT = "sent by the driver"


def request(name: str, number: int, data: bytes = b"") -> bytes:
    return bytes(xsens(name, number, "", data).data)


def packet(descriptor_set: int, number: int, data: bytes = b"") -> bytes:
    return bytes(mip("", descriptor_set, number, data).data)


def output_configuration(vector: Vector) -> bytes:
    listed = b"".join(struct.pack(">HH", int(did, 16), rate) for did, rate in vector["decoded"]["config"])
    return request("SetOutputConfiguration", 0xC0, listed)


def utility(vector: Vector) -> bytes:
    name, *values = vector["decoded"]["ascii"].removesuffix("<CR>").rpartition(",")[0].removeprefix("$").split(",")
    return bytes(stim300(name, *values).data)


def line(vector: Vector) -> bytes:
    return bytes(vectornav(vector["decoded"]["ascii"].partition("*")[0].removeprefix("$")))


def register(number: int, value: int) -> bytes:
    return bytes(witmotion.write("", number, value).data)


MIP_COMMANDS = [
    ("756501020202", 0x01, 0x02, "", SENT),
    ("756501020203", 0x01, 0x03, "", SENT),
    ("756501020206", 0x01, 0x06, "", SENT),
    ("75650c020206", 0x0C, 0x06, "", SENT),
    ("75650c0e0e0f", 0x0C, 0x0F, "018003d5000a04000a05000a", SENT),
    ("756501020201", 0x01, 0x01, "", FRAMING),
    ("75650c050511", 0x0C, 0x11, "010101", FRAMING),
    ("75650c070740", 0x0C, 0x40, "010001c200", NEVER),
    ("75650c030330", 0x0C, 0x30, "03", NEVER),
    ("75650c040401", 0x0C, 0x01, "0000", FRAMING),
    ("75650c0a0a01", 0x0C, 0x01, "0002040000050000", FRAMING),
    ("75650c08080d", 0x0C, 0x0D, "008003d50405", FRAMING),
]


def mip_rule(begin: str, descriptor_set: int, number: int, data: str, use: str) -> Rule:
    return (
        lambda one: one["hex"].startswith(begin),
        lambda _: packet(descriptor_set, number, bytes.fromhex(data)),
        use,
    )


RULES: dict[str, list[Rule]] = {
    "stim300": [
        (lambda one: one["decoded"].get("ascii", "").startswith("$save"), utility, NEVER),
        (lambda one: one["decoded"].get("ascii", "").startswith("$sm"), utility, SENT),
        (lambda one: one["decoded"].get("ascii", "").startswith("$"), utility, FRAMING),
    ],
    "xsens_mtdata2": [
        (lambda one: one["decoded"].get("message") == "GoToConfig", lambda _: request("", 0x30), SENT),
        (lambda one: one["decoded"].get("message") == "GoToMeasurement", lambda _: request("", 0x10), SENT),
        (lambda one: one["decoded"].get("message") == "ReqFirmwareRev", lambda _: request("", 0x12), SENT),
        (lambda one: one["decoded"].get("message") == "ReqConfiguration", lambda _: request("", 0x0C), FRAMING),
        (lambda one: one["decoded"].get("message") == "InitMT", lambda _: request("", 0x02), FRAMING),
        (lambda one: one["decoded"].get("message") == "SetStringOutputType", lambda _: request("", 0x8E, bytes(2)), NEVER),
        (lambda one: one["decoded"].get("mid") == "0xC0", output_configuration, NEVER),
    ],
    "vectornav": [
        (lambda one: one["decoded"].get("type") == "VNRRG" and len(one["decoded"]["args"]) == 1, line, SENT),
        (lambda one: one["decoded"].get("type") == "VNWRG", line, SENT),
    ],
    "microstrain_mip": [mip_rule(*one) for one in MIP_COMMANDS],
    "aceinna_openimu_serial": [
        (lambda one: one["decoded"].get("type") == "PK", lambda _: aceinna("", "PK", b"", "").data, FRAMING),
    ],
    "witmotion": [
        (lambda one: one["hex"] == "ffaa6988b5", lambda _: register(0x69, 0xB588), SENT),
        (lambda one: one["hex"].startswith("ffaa03"), lambda one: register(0x03, one["decoded"]["value"]), SENT),
        (lambda one: one["hex"] == "ffaa272e00", lambda _: witmotion.read("", 0x2E).data, SENT),
        (lambda one: one["hex"] == "ffaa000000", lambda _: register(0x00, 0), NEVER),
        (lambda one: one["hex"] == "ffaa00ff00", lambda _: register(0x00, 0xFF), NEVER),
        (lambda one: one["hex"] == "ffaa040600", lambda _: register(0x04, 6), NEVER),
    ],
}

FROM_INSTRUMENT: dict[str, Callable[[Vector], bool]] = {
    "stim300": lambda one: not one["decoded"].get("ascii", "").startswith("$"),
    # Answers have odd message ids, data has 0x36.
    "xsens_mtdata2": lambda one: (
        one["decoded"].get("mid") is None or int(one["decoded"]["mid"], 16) % 2 == 1 or "fields" in one["decoded"]
    ),
    "vectornav": lambda one: (
        one.get("kind") != "ascii"
        or one["decoded"].get("type") not in ("VNRRG", "VNWRG")
        or (one["decoded"]["type"] == "VNRRG" and len(one["decoded"]["args"]) > 1)
    ),
    "microstrain_mip": lambda one: (
        one["decoded"]["descriptor_set"] not in ("0x01", "0x0C")
        or any("ack_echo" in field for field in one["decoded"]["fields"])
        or len(one["decoded"]["fields"]) != 1
    ),
    "aceinna_openimu_serial": lambda one: one["decoded"].get("type") != "PK",
    "witmotion": lambda one: one.get("kind") != "command",
}
"""Vectors that an instrument sends; of MIP also packets of no and of several commands, which a driver never sends."""
NO_COMMANDS = {"kvh_1750", "novatel_rawimu", "sbg_sbgecom", "can_imus", "aceinna_mtlt_can"}
"""Instruments that are listened to only, and the CAN bus, whose commands have tests beside its driver."""


def vectors(shared: Path, name: str) -> list[Vector]:
    return list(json.loads((shared / "wire" / f"{name}.vectors.json").read_text(encoding="utf-8")))


def test_every_file_of_vectors_is_looked_at(shared_folder: Path) -> None:
    names = {path.name.removesuffix(".vectors.json") for path in (shared_folder / "wire").glob("*.vectors.json")}
    assert names == set(RULES) | NO_COMMANDS
    for name in NO_COMMANDS:
        assert not [one for one in vectors(shared_folder, name) if one.get("kind") == "command"]


@pytest.mark.parametrize("name", RULES)
def test_every_command_of_a_host_equals_what_we_send(name: str, shared_folder: Path) -> None:
    compared = 0
    for one in vectors(shared_folder, name):
        if FROM_INSTRUMENT[name](one):
            continue
        found = [build for matches, build, _ in RULES[name] if matches(one)]
        assert found, f"no command of the driver for {one['hex']} ({one.get('note')})"
        data = bytes.fromhex(one["hex"])
        assert found[0](one) == data, one
        compared += 1
    assert compared >= len(RULES[name]) - (name == "stim300")


@pytest.mark.parametrize("name", RULES)
def test_no_rule_stands_for_nothing(name: str, shared_folder: Path) -> None:
    found = [one for one in vectors(shared_folder, name) if not FROM_INSTRUMENT[name](one)]
    unused = [number for number, (matches, _, _) in enumerate(RULES[name]) if not any(map(matches, found))]
    assert unused == []


@pytest.mark.parametrize("name", RULES)
def test_what_must_not_be_sent_is_refused_by_the_list_of_it(name: str, shared_folder: Path) -> None:
    driver = {"vectornav": "vectornav_ascii", "aceinna_openimu_serial": "aceinna_serial"}.get(name, name)
    for one in vectors(shared_folder, name):
        uses = [use for matches, _, use in RULES[name] if not FROM_INSTRUMENT[name](one) and matches(one)][:1]
        if uses and uses[0] != FRAMING:
            assert FORBIDDEN[driver](bytes.fromhex(one["hex"])) == (uses[0] == NEVER), one
