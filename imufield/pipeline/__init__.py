"""The rooms joined for the commands: capture chain, calibration, damage, site. Nothing is printed here."""
