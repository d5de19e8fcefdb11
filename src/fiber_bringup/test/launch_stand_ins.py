# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for launch, which is not among the wheels: what the launch file is made of."""

import runpy
import sys
import types
from functools import partial
from pathlib import Path

import pytest

SHARE = Path(__file__).parents[1]
_PATH = SHARE / "launch" / "focal_plane.launch.py"


class Made:
    """What a class of launch would be: its name, and the values that it was given."""

    def __init__(self, kind, *args, **given):
        self.kind, self.args, self.given = kind, args, given

    def perform(self, context):
        return context.configurations[self.args[0]]

    def __eq__(self, other):
        return isinstance(other, Made) and vars(self) == vars(other)


class Module(types.ModuleType):
    """A module of launch, which is not among the wheels."""

    def __getattr__(self, name):
        return partial(Made, name)


def load():
    """Return the launch file as a module, and its description made of `Made`."""
    names = ["launch", "launch.actions", "launch.conditions", "launch.events"]
    names += ["launch.events.process", "launch.substitutions", "launch_ros"]
    names += [
        f"launch_ros.{name}" for name in ("actions", "parameter_descriptions", "substitutions")
    ]
    with pytest.MonkeyPatch.context() as patch:
        for name in names:
            patch.setitem(sys.modules, name, Module(name))
        module = runpy.run_path(str(_PATH))
        return module, module["generate_launch_description"]()


def everything(made):
    """All that a value is made of."""
    if isinstance(made, Made):
        yield made
        yield from everything([*made.args, *made.given.values()])
    elif isinstance(made, (list, tuple)):
        for each in made:
            yield from everything(each)
    elif isinstance(made, dict):
        yield from everything(list(made.values()))


def all_of(description, kind):
    return [each for each in everything(description) if each.kind == kind]
