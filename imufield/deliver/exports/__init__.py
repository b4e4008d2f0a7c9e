"""Parameters in the form other programs read: one module per target, one conversion layer (``conventions``).

``export_parameters(parameters, "px4")`` returns the files and, in sentences with numbers, what the target cannot hold.
"""

from imufield.deliver.exports.registry import TARGETS, export_options, export_parameters, target, write_exported
from imufield.deliver.exports.target import Exported, ExportOptions, Target

__all__ = [
    "TARGETS",
    "ExportOptions",
    "Exported",
    "Target",
    "export_options",
    "export_parameters",
    "target",
    "write_exported",
]
