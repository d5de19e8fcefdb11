"""A client of the focal-plane graph: send targets, follow, start, stop, read outcomes."""

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneError, PlaneRefusal

__all__ = ["PlaneClient", "PlaneError", "PlaneRefusal"]
