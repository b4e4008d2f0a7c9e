"""The truth of a simulation: error model of the instrument, its motion, the operator, the drift."""
