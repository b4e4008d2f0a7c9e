"""Solvers with one interface."""
