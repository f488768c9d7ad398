"""Studies: many fits over a declared design, on one machine or many, into one tidy table."""
