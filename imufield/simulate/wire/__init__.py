"""From samples to bytes, lines and CAN frames: the decoder turned around."""
