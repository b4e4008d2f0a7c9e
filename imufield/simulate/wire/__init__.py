"""Encoders: from samples to binary frames, lines of text and CAN frames; the reverse of ``acquire/decode``."""
