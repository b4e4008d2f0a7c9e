"""Wire formats as data: TOML for byte streams, DBC for CAN."""
