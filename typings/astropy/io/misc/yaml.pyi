# SPDX-License-Identifier: Apache-2.0
"""What the project uses of astropy.io.misc.yaml."""

from typing import Any

def load(stream: str) -> Any: ...
