"""The command line: one file per verb, no arithmetic, heavy imports inside the command."""
