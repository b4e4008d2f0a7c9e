"""The report: one self-contained page per session, and a calibration record of one sheet."""
