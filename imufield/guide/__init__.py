"""The guide of a session: positions, stillness, the state table that leads the operator, and views of its events."""
