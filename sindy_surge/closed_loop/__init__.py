"""Compressor, duct and plenum discovered as a surge model that cycles by itself."""

from __future__ import annotations

from sindy_surge.closed_loop.discovery import discover_surge_model
from sindy_surge.closed_loop.model import CycleRow, LoopState, SurgeModel

__all__ = ["CycleRow", "LoopState", "SurgeModel", "discover_surge_model"]
