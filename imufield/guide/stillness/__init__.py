"""Stillness: is the unit still or moving? Cells, noise floor, limits, stretches and their edges."""
