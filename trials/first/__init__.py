"""Sealed blind trials: recordings with a known omission, from physics written at a lower level than errpipe's terms.

Nothing here imports errpipe's terms or its diagnosis; `run` alone calls the public command.
"""
