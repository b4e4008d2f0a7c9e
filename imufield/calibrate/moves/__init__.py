"""Moves between still positions: their sums, where they begin and end, and the ends of the range that they reach."""
