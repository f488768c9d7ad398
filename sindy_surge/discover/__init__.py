"""Structure discovered from measured states."""
