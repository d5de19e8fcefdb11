# SPDX-License-Identifier: Apache-2.0
"""Exit codes of the command."""

__all__ = ["DONE", "INTERRUPTED", "REFUSED"]

DONE = 0
REFUSED = 2  # an argument, a file or a problem is refused
INTERRUPTED = 130  # Ctrl-C
