"""Columns that may be longer than memory, and what is computed over them block by block."""
