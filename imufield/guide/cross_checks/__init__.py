"""What the positions together show: running fit, exchanged axes, a dead axis or side."""
