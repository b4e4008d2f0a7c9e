"""Sources of raw bytes: serial port, TCP address and CAN bus, their clocks and errors, and reconnecting."""

from imufield.acquire.link.serial import COLLECT_S as COLLECT_S
from imufield.acquire.link.serial import READ_LIMIT_BYTES as READ_LIMIT_BYTES
from imufield.acquire.link.serial import WAIT_S as WAIT_S
from imufield.acquire.link.serial import WRITE_TIMEOUT_S as WRITE_TIMEOUT_S
from imufield.acquire.link.serial import Chunk as Chunk
from imufield.acquire.link.serial import Link as Link
from imufield.acquire.link.serial import Port as Port
from imufield.acquire.link.serial import SerialLink as SerialLink
from imufield.acquire.link.serial import SerialSettings as SerialSettings
from imufield.acquire.link.serial import not_taken as not_taken
from imufield.acquire.link.serial import open_link as open_link
