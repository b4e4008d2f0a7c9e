"""From bytes, lines and CAN frames to samples that have no time yet."""
