# SPDX-License-Identifier: Apache-2.0
"""Shared by the tests of this package: the settings of properties, and the real focal planes."""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.append(str(Path(__file__).parent))  # for the modules that tests share

# New draws in every run: a law holds for all of them, and a failure prints how to repeat it.
settings.register_profile("laws", derandomize=False, database=None, deadline=None, print_blob=True)
settings.load_profile("laws")


@pytest.fixture(scope="session")
def real_planes() -> Path:
    """Folder of the real focal planes, from FIBER_DATA; skips where it is absent."""
    default = Path(__file__).resolve().parents[4] / "shared" / "data"
    folder = Path(os.environ.get("FIBER_DATA", default))
    if not (folder / "desi_2021-06-25.csv").exists():
        pytest.skip(f"no real focal planes in {folder}; set FIBER_DATA")
    return folder
