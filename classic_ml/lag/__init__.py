"""The first-order lag in compiled loops: simulation, derivatives, the Gauss-Newton step."""
