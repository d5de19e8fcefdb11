# SPDX-License-Identifier: Apache-2.0
"""What the nodes of a plane import and compile, for the process from which they are forked."""

import importlib

import numpy as np
from forked_processes import MAINS

from fiber_bus_bridge.plant.rehearsal import rehearse
from fiber_core.presets import preset
from fiber_positioners import make_orders, random_problem

for module in MAINS.values():
    importlib.import_module(module)
rehearse()
make_orders(random_problem(preset("desi", 19), np.random.default_rng(0)))
