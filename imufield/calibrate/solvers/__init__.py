"""Solvers with one interface (``base``), their names (``registry``), costs, and their agreement."""
