"""The calibration certificate: as a page, as JSON, as a digital calibration certificate, with a label."""
