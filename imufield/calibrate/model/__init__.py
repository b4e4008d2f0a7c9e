"""Error models, observations, gauge, observability and uncertainty: what every calibration shares."""
