"""The recorded sessions of the commands' tests."""

from __future__ import annotations

from tests.commands.conftest import solved_session, whole_session

__all__ = ["solved_session", "whole_session"]
