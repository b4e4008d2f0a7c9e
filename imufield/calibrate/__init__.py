"""Error models, observations, solvers, uncertainty."""
