"""Discovery of the equations of a measured system, dx/dt = Θ(x, u) Ξ."""

from __future__ import annotations

from sindy_surge.discover.dynamics import SparseDynamics

__all__ = ["SparseDynamics"]
