"""What a link hands on: bytes with the time of their arrival. Whoever reads them from a file needs no port."""

from __future__ import annotations

from imufield.dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes of one read.

    Attributes
    ----------
    data : bytes
    monotonic_s : float
        Host arrival of the *last* byte, monotonic clock; up to ``COLLECT_S`` late on a wire that then fell silent.
    utc_ns : int
        The same moment, nanoseconds since 1970-01-01 UTC.
    """

    data: bytes
    monotonic_s: float
    utc_ns: int
