"""The same workflow on a user's own simulation model and measured records."""
