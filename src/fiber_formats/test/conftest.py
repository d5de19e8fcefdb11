# SPDX-License-Identifier: Apache-2.0
"""Shared by the tests of this package: settings of properties, made-up files, and real ones."""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.append(str(Path(__file__).parent))  # for what they share in modules of its own

# New draws in every run: a law holds for all of them, and a failure prints how to repeat it.
settings.register_profile("laws", derandomize=False, database=None, deadline=None, print_blob=True)
settings.load_profile("laws")


@pytest.fixture(scope="session")
def made_up() -> Path:
    """Folder of small made-up files in the shape of the instruments' own."""
    return Path(__file__).parent / "data"


@pytest.fixture(scope="session")
def real_files() -> Path:
    """Folder of the real files, from FIBER_DATA; skips where it is absent."""
    default = Path(__file__).resolve().parents[4] / "shared" / "data"
    folder = Path(os.environ.get("FIBER_DATA", default))
    if not (folder / "cases" / "INDEX.md").exists():
        pytest.skip(f"no real files in {folder}; set FIBER_DATA")
    return folder
