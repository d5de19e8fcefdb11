"""Shared by the tests of this package: repeatable properties, and the real focal planes."""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.append(str(Path(__file__).parent))  # for the modules that tests share

settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def real_planes() -> Path:
    """Folder of the real focal planes, from FIBER_DATA; skips where it is absent."""
    default = Path(__file__).resolve().parents[4] / "shared" / "data"
    folder = Path(os.environ.get("FIBER_DATA", default))
    if not (folder / "desi_2021-06-25.csv").exists():
        pytest.skip(f"no real focal planes in {folder}; set FIBER_DATA")
    return folder
