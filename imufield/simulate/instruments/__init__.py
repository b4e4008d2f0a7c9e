"""Emulated instruments, one module for each family: what they send and how they answer commands."""
