"""What every node of the graph does alike: settings, reporting, following the plane, running."""

from fiber_node.parameters import declare_parameters_of
from fiber_node.plane_cache import PlaneCache
from fiber_node.reporter import Reporter
from fiber_node.ros_client import RosClient, WaitError
from fiber_node.run_node import run

__all__ = ["RosClient", "PlaneCache", "Reporter", "WaitError", "declare_parameters_of", "run"]
