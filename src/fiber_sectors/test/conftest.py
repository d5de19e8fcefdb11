# SPDX-License-Identifier: Apache-2.0
"""Make the helper modules in this folder importable."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
