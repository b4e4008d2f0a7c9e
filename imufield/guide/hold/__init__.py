"""One hold: its mean at rest or in the hand, its duration and its checks."""
