#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Draw which package imports which, from the imports themselves, into docs/architecture.md.

Between two marker lines of that page stands a Mermaid graph; this command writes it anew, or with
--check says whether it is up to date. An arrow A --> B means that A imports B; arrows that follow
from others are left out.
"""

import argparse
import ast
import sys
from pathlib import Path

__all__ = ["imports", "imports_of", "mermaid", "package_arrows", "project_modules"]

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "architecture.md"
_ROS = {"rclpy", "sensor_msgs", "std_msgs"}
_ROS_PACKAGES = {"fiber_msgs_py", "fiber_node", "fiber_client", "fiber_console", "fiber_bringup"}
BEGIN, END = "<!-- begin: tools/import_graph.py -->", "<!-- end: tools/import_graph.py -->"


def packages() -> list[str]:
    """Return the names of the packages in src/."""
    return sorted(path.parent.name for path in (ROOT / "src").glob("*/setup.py"))


def imports(source: str, module: str, is_package: bool, modules: set[str]) -> list[str]:
    """Return absolute names of all modules that a source imports.

    Args:
        source: Python source.
        module: its dotted name, for relative imports.
        is_package: whether it is the `__init__` of a package.
        modules: dotted names of the project's own modules.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = module.split(".")
                parents = parents[: len(parents) - node.level + is_package]
                base = ".".join([*parents, *base.split(".")] if base else parents)
            for alias in node.names:
                inside = f"{base}.{alias.name}"
                found.append(inside if inside in modules else base)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found += [
                arg.value
                for arg in node.args[:1]
                if isinstance(arg, ast.Constant) and isinstance(arg.value, str)
            ]
    return found


def project_modules() -> dict[str, Path]:
    """Return the file of every module of the packages and of bench/, by dotted name."""
    found = {}
    for folder in [*(ROOT / "src" / name / name for name in packages()), ROOT / "bench"]:
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(module: str, modules: dict[str, Path]) -> list[str]:
    """Return absolute names of all modules that a module of the project imports."""
    path = modules[module]
    return imports(path.read_text(), module, path.name == "__init__.py", set(modules))


def compartments(modules: dict[str, Path]) -> dict[str, str]:
    """Return the box of the picture that each module is in: its package, or its package's ROS part.

    The ROS part of a package are the modules that import rclpy or a package that does, where the
    package also has modules that do not.
    """
    uses = {module: imports_of(module, modules) for module in modules}
    ros = {m for m in modules if any(t.split(".")[0] in _ROS for t in uses[m])}
    while more := {m for m in modules if m not in ros and ros & set(uses[m])}:
        ros |= more
    pure = {module.split(".")[0] for module in set(modules) - ros if "." in module}
    return {
        module: f"{package} node" if module in ros and package in pure - _ROS_PACKAGES else package
        for module in modules
        if (package := module.split(".")[0]) in packages()
    }


def package_arrows() -> set[tuple[str, str]]:
    """Return pairs of boxes of which the first imports the second, without those that follow."""
    modules = project_modules()
    box = compartments(modules)
    uses: dict[str, set[str]] = {name: set() for name in box.values()}
    for module, own in box.items():
        uses[own] |= {box[target] for target in imports_of(module, modules) if target in box} - {
            own
        }

    def reached(name: str) -> set[str]:
        found: set[str] = set()
        todo = list(uses[name])
        while todo:
            other = todo.pop()
            if other not in found:
                found.add(other)
                todo += uses[other]
        return found

    return {
        (name, other)
        for name in uses
        for other in uses[name]
        if not any(other in reached(third) for third in uses[name] - {other})
    }


def mermaid() -> str:
    """Return the graph of the packages as a Mermaid block."""
    lines = ["```mermaid", "graph TD"]
    for name in sorted(set(compartments(project_modules()).values())):
        ros = name.endswith(" node") or name in _ROS_PACKAGES
        key = name.replace(" ", "_")
        lines.append(f"    {key}([{name}])" if ros else f"    {key}[{name}]")
    for user, used in sorted(package_arrows()):
        lines.append(f"    {user.replace(' ', '_')} --> {used.replace(' ', '_')}")
    return "\n".join([*lines, "```"])


def main() -> int:
    """Write the graph into the page, or check it; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; 1 if it is stale")
    options = parser.parse_args()
    text = PAGE.read_text()
    head, rest = text.split(BEGIN)
    fresh = f"{head}{BEGIN}\n{mermaid()}\n{END}{rest.split(END)[1]}"
    if options.check:
        if fresh != text:
            print(f"{PAGE} is stale: run tools/import_graph.py", file=sys.stderr)
        return int(fresh != text)
    PAGE.write_text(fresh)
    return 0


if __name__ == "__main__":
    sys.exit(main())
