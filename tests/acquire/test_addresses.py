"""Addresses that programs of others import still give every public name that they had before the modules moved."""

from __future__ import annotations

import importlib

import pytest

NAMES = {
    "imufield.acquire.can_logs": "CHUNK_FRAMES CHUNK_S SUFFIXES begins_as_can_log import_log is_can_log read_log replay_frames "
    "replay_to_bus",
    "imufield.acquire.checksum": "Bytes Checksum Crc Fletcher Positions Sum Values Xor checksum_names make_checksum",
    "imufield.acquire.driver": "Ability Driver Evidence Wire choose_divisor choose_rate Command Message any_message",
    "imufield.acquire.exchange": "ANSWER_S TRIES Command Exchange Message any_message",
    "imufield.acquire.instrument": "Instrument",
    "imufield.acquire.instrument.exchange": "ANSWER_S TRIES Command Exchange Message any_message",
    "imufield.acquire.link": "COLLECT_S READ_LIMIT_BYTES WAIT_S WRITE_TIMEOUT_S Chunk Link Port SerialLink SerialSettings "
    "not_taken open_link",
    "imufield.acquire.protocol": "DBC_LIMIT_BYTES FOLDER SCHEMA_VERSION Nominal Protocol decode_dbc load_protocol "
    "parse_protocol protocol_names",
    "imufield.deliver.parameters": "PARAMETER_FILE Context Corrected InstrumentFacts Noise Parameters SessionFacts "
    "from_document json_ready load parameter_schema to_document to_toml write_document write_parameters",
}


@pytest.mark.parametrize("address", NAMES)
def test_an_address_gives_every_name_it_had(address: str) -> None:
    module = importlib.import_module(address)
    missing = [name for name in NAMES[address].split() if not hasattr(module, name)]
    assert not missing


@pytest.mark.parametrize("address", ["imufield.acquire.instrument", "imufield.acquire.link", "imufield.acquire.protocol"])
def test_a_name_that_never_was_is_an_attribute_error(address: str) -> None:
    module = importlib.import_module(address)
    with pytest.raises(AttributeError, match="never"):
        _ = module.never
