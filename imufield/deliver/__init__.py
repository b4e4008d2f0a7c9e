"""The result: parameter file, exports, report, verification."""
