"""Find the instrument on a port or bus, recognise it, and send it commands: identity, start, stop, output rate."""

from imufield.acquire.instrument.instrument import Instrument as Instrument
