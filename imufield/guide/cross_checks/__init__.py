"""Checks across positions: running fit, exchanged axes, wrong sides, a dead axis."""
