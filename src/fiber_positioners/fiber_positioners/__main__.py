# SPDX-License-Identifier: Apache-2.0
"""`python -m fiber_positioners`: the command fiber-positioners."""

import sys

from fiber_positioners.command import main

if __name__ == "__main__":
    sys.exit(main())
