"""The harness that sets the estimators side by side, and the simulated rig they are tried on."""

from __future__ import annotations
