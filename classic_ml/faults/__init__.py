"""Readings that do not count, and channels that contradict each other or the facility."""
