"""Still or moving: cells, noise floor, limits, stretches and their edges."""
