"""Studies of what a calibration says of itself: effects one at a time, and how often its answers stay right."""
