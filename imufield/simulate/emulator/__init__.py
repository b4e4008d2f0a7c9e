"""Virtual instruments on a pseudo-terminal or a CAN bus, with faults."""
