"""Drivers: one file per instrument family (constants, link defaults, commands, identity)."""
