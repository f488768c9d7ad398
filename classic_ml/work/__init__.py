"""The work coefficient: its forms of the temperature, its balance and its own lag."""
