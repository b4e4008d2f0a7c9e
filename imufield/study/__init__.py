"""Reproduction of the papers' tables and figures, and Monte-Carlo campaigns."""
