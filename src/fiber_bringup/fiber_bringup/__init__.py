"""Starts the node graph of a focal plane and takes it through a reconfiguration."""
