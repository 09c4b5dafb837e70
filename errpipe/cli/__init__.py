"""The command line: one function per verb, no arithmetic, heavy imports inside the command."""
