# SPDX-License-Identifier: Apache-2.0
"""The metrology as a node."""

from fiber_metrology.node.metrology import MetrologyNode, main

__all__ = ["MetrologyNode", "main"]
