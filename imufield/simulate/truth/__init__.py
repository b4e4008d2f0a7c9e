"""What is true in a simulation: error model, motion, operator, drift."""
