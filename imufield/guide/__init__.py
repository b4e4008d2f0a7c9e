"""Positions, stillness and the state table that leads the operator; views of its events."""
