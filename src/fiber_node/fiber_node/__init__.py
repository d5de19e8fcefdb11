"""What every node of the graph does alike: settings, reporting, following the plane, running."""

from fiber_node.peer import Peer, WaitError
from fiber_node.plane_view import PlaneView
from fiber_node.reporter import Reporter
from fiber_node.running import run
from fiber_node.settings import declare_settings

__all__ = ["Peer", "PlaneView", "Reporter", "WaitError", "declare_settings", "run"]
