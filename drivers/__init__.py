"""Drivers: one file per instrument family (constants, link defaults, commands, output rate, identity)."""
