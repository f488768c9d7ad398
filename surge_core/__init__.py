"""The shared ground: errors, types, segments, the discrete lag, rounding and display."""
