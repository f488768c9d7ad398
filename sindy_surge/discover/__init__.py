"""Equations and surge loops discovered from measured states."""
