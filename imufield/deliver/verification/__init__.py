"""Proof: positions left out of the calibration, and the result of a verification."""
