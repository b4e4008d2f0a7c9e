"""Simulated instruments, operators and links."""
