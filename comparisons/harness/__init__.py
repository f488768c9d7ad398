"""Estimators side by side on the same rows: comparison, reconstruction, trial of τ."""
