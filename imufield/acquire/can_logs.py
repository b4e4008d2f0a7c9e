"""Logs of CAN buses: the import address for other packages; the code is in ``formats.can_logs``."""

from imufield.acquire.formats.can_log_heads import *  # noqa: F403  the names are listed below
from imufield.acquire.formats.can_logs import *  # noqa: F403  the names are listed below

__all__ = ["CHUNK_FRAMES", "CHUNK_S", "SUFFIXES", "begins_as_can_log", "import_log", "is_can_log"]  # noqa: F405
__all__ += ["read_log", "replay_frames", "replay_to_bus"]  # noqa: F405
