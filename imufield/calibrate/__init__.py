"""From observations to parameters: error models, the two triads, solvers, uncertainty, noise."""
