"""What the tests of this package share stands beside them, in modules of its own."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
