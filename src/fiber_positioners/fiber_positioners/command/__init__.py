# SPDX-License-Identifier: Apache-2.0
"""The command `fiber-positioners`: plan one field, study many, make a player."""

from fiber_positioners.command.main import main

__all__ = ["main"]
