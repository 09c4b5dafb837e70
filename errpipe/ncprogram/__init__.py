"""NC programs (RS-274, the LinuxCNC dialect): read with their modal state, and corrected off-line.

The paper's first method of compensation, off-line. What is not understood is refused with its line: a
program is corrected whole or not at all.
"""
