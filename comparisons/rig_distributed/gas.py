"""The gas of the distributed rig: dry air, perfect, in SI."""

from __future__ import annotations

GAMMA = 1.4
# J/(kg K).
R = 287.05
CP = GAMMA * R / (GAMMA - 1.0)
