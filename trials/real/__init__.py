"""Real twins: a real recording's repetition stands in for the simulation of another repetition of itself."""
