# SPDX-License-Identifier: Apache-2.0
"""The packages of the project, their modules, and what these import."""

from pathlib import Path

import import_graph

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
PACKAGES = sorted(path.parent.name for path in SOURCE.glob("*/setup.py"))
MODULES = import_graph.project_modules()


def starts(module: str, prefix: str) -> bool:
    return module == prefix or module.startswith(prefix + ".")


def imports_of(module: str) -> list[str]:
    return import_graph.imports_of(module, MODULES)
