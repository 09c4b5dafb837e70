"""From a machine's chain to the deviation at its tool, and back: synthesis, identification, test design."""
